"""Runs a command and prints its seconds, the largest memory that it took as the system counts it, and its exit status.

A process of its own, run as a file: Linux counts in a process's memory that of the one it was started from, which must
therefore be smaller than what is measured. So it imports nothing of crowdbench.
"""

import os
import subprocess
import sys
import time

if __name__ == "__main__":
    begin = time.perf_counter()
    process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    print(time.perf_counter() - begin, usage.ru_maxrss, os.waitstatus_to_exitcode(status))
