"""Every backend, used and abused at random, keeps the contract at its wire.

`benchmarks/backends/contract.py` does the same for as many cycles as it is given.
"""

from contextlib import nullcontext
from dataclasses import replace

import pytest
import rigs
from attacker import ACTIONS, Attacker
from fri_messages import compile_schema
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule, run_state_machine_as_test
from lanes import later

RUNS, STEPS = 3, 24  # of about 12 cycles each


@pytest.fixture(scope="module")
def schema(tmp_path_factory):
    return compile_schema(tmp_path_factory.mktemp("schema"))


RIGS = ["virtual", "fri", "mujoco", "damiao", "jerk", "fri-torque", "cia402"]


@pytest.fixture(params=later(RIGS, "hundreds of cycles of random use each", first=2))
def opened(request, schema):
    """Return what opens one of them."""
    return rigs.every(schema)[request.param]


def machine(opened, counted):
    """Return a state machine that attacks a robot of its own in each run."""

    class Abuse(RuleBasedStateMachine):
        def __init__(self):
            super().__init__()
            self.context = opened()
            self.attacker = Attacker(self.context.__enter__())

        @rule(action=st.sampled_from(ACTIONS), seed=st.integers(0, 2**31))
        def act(self, action, seed):
            self.attacker.act(action, seed)

        @rule(which=st.integers(0, 99), seed=st.integers(0, 2**31))
        def fail(self, which, seed):
            if faults := self.attacker.rig.faults:
                self.attacker.fail(faults[which % len(faults)], seed)

        def teardown(self):
            counted.append(self.attacker.cycles)
            self.context.__exit__(None, None, None)

    return Abuse


def test_random_use_keeps_the_contract_at_the_wire(opened):
    counted = []
    run_state_machine_as_test(
        machine(opened, counted),
        settings=settings(
            max_examples=RUNS,
            stateful_step_count=STEPS,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
    assert sum(counted) > 500


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("torque", "torque rate"),
        ("position", "velocity"),
        ("position", "range"),
        ("position", "jerk"),
        ("torque", "not finite"),
    ],
)
def test_the_judge_notices(what, said):
    """What it watches for, once each, where the drives of a simulated arm are tampered with."""
    import numpy as np
    from wire_rules import POSITION, TORQUE, Applied, Judge

    with rigs.virtual() as rig:
        judge, state = Judge(rig.robot.spec), rig.robot.receive()
        zero, q = np.zeros(7), state.position

        def applied(mode, position, torque):
            return Applied(mode, position, torque, zero, zero)

        if what == "torque":
            judge.judge(applied(TORQUE, zero, zero), state)
            bad = np.full(7, np.nan) if said == "not finite" else np.full(7, 30.0)
            with pytest.raises(AssertionError, match=said):
                judge.judge(applied(TORQUE, zero, bad), state)
            return
        if what == "position" and said == "jerk":
            jerky = replace(rig.robot.spec, jerk=np.full(7, 1000.0))
            for spec, matters in ((rig.robot.spec, False), (jerky, True)):
                judge, step = Judge(spec), 5e-6  # [rad] in a cycle, and none in the next
                for where in (q, q, q + step):
                    judge.judge(applied(POSITION, where, zero), state)
                with pytest.raises(AssertionError, match=said) if matters else nullcontext():
                    judge.judge(applied(POSITION, q + step, zero), state)
            return
        end = rig.robot.spec.limits.position_max
        where, away = (end, 1e-6) if said == "range" else (q, 0.01)
        judge.judge(applied(POSITION, where, zero), state)
        with pytest.raises(AssertionError, match=said):
            judge.judge(applied(POSITION, where + away, zero), state)
