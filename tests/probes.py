"""A planner that tries actions in its sandbox and reports the results in its facts, for tests of isolation."""

import contextlib

from crowdbench.isolation.isolated_planner import IsolatedPlanner, ResourceLimits

PROBE = """
import ctypes, json, mmap, os, signal, socket, subprocess, sys, threading, time
import numpy as np
import crowdbench

class Probe(crowdbench.Planner):
    def __init__(self, facts=(), **more):
        self.facts = {**dict(facts), **more}

    def plan(self, obs):
        return np.zeros((len(obs), 2))

def tried(action):
    try:
        return str(action())
    except OSError as error:
        return type(error).__name__

def forked(count, work):
    for _ in range(count):
        if os.fork() == 0:
            work()
            os._exit(0)

def planner(file="none"):
"""


@contextlib.contextmanager
def made(folder, body, most=ResourceLimits(), options=None, **settings):  # noqa: B008 (immutable)
    """A planner in its sandbox, whose function has a body that returns a `Probe`."""
    path = folder / "probe.py"
    path.write_text(PROBE + "".join(f"    {line}\n" for line in body.strip().splitlines()))
    with contextlib.closing(IsolatedPlanner(str(path), options or {}, most, **settings)) as planner:
        yield planner


def probe(folder, body, most=ResourceLimits(), **options):  # noqa: B008 (immutable)
    """Return the facts that a planner tells of its sandbox, by name."""
    with made(folder, body, most, options) as planner:
        return planner.facts
