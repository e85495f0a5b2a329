"""All measurements of `crowdbench bench`, in the order of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from crowdbench.bench import commands, decisions, simulator
from crowdbench.bench.measurement import Measurement

SUITE: tuple[Callable[[], Iterator[Measurement]], ...] = (
    simulator.measure_one_world,
    simulator.measure_many_worlds,
    simulator.measure_whole_step,
    simulator.measure_sight,
    simulator.measure_thousands,
    simulator.measure_environment,
    simulator.measure_vec_env,
    decisions.measure_isolation,
    decisions.measure_sarl_batch,
    decisions.measure_sarl_single,
    decisions.measure_share_of_limit,
    decisions.measure_training,
    decisions.measure_sarl_sgan_kce_batch,
    decisions.measure_sarl_sgan_kce_single,
    decisions.measure_sarl_sgan_seq_batch,
    commands.measure_start_up,
    commands.measure_orca_runs,
    commands.measure_sarl_runs,
    commands.measure_sarl_sgan_kce_run,
)
