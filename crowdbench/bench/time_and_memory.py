"""Runs a command, and prints its time in seconds, its peak memory in the system's unit, and its exit status.

This file is run in a process of its own and imports nothing of crowdbench, because Linux counts the memory of the
parent process as memory of its child: the parent must be smaller than what is measured.
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
