import subprocess
import sys


def test_the_public_functions_are_functions_whatever_was_imported_before():
    code = (
        "import inspect, crowdbench.cli, crowdbench.runs.run, crowdbench.check\n"
        "from crowdbench import flatten, load_planner, load_scenario, parallel_env, rollout\n"
        "print(all(map(inspect.isfunction, (flatten, load_planner, load_scenario, parallel_env, rollout))))"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "True\n"
