"""`limo.serve` in the process that asks for it, with a driver of `limo.run` beside it."""

import gc
import signal
import sys
import threading
from functools import partial

import numpy as np
import pytest
from lanes import sampled
from sessions import configurations_of_two

import limo_driver as limo
from estimators.service.settings import RetrainingSettings, ServiceSettings
from limo_driver.errors import ConfigError
from limo_driver.network.readiness import ServicePhase
from limo_driver.physics import ViscousFriction

pytestmark = pytest.mark.waits

BELIEVED = limo.Simulation("iiwa14", tuple(ViscousFriction(joint=j, f_v=1.0) for j in range(1, 8)))
START = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])


@pytest.fixture
def ends(tmp_path):
    """Configurations of the service, which listens, and of the driver, which connects."""
    return configurations_of_two(tmp_path)


def test_a_driver_is_answered_and_the_process_is_left_as_it_was(ends, tmp_path):
    service_end, driver_end = ends
    t = np.linspace(0.0, 0.8, 201)
    swing = START + 0.01 * np.sin(np.pi * t / 0.8)[:, None] ** 4
    motion = limo.Motion.from_positions(t, swing)
    motion = limo.Trajectory(t, swing, motion.velocity, motion.acceleration, robot="iiwa14")
    before = sys.getswitchinterval(), signal.getsignal(signal.SIGTERM), gc.isenabled()
    told, shown = [], []
    serve = partial(
        limo.serve, store=tmp_path / "models", simulation=BELIEVED, config=service_end,
        told=lambda arm, event: told.append((arm, event.facts.get("phase"))), show=shown.append,
    )  # fmt: skip
    with serve("left") as service:
        assert service.phases == {"left": ServicePhase.WAITING}
        stream = limo.Streaming("left", wait_for_estimates=60.0, config=driver_end)
        recording = limo.run("mujoco", motion, simulation=BELIEVED, rate=250, stream=stream)
        assert service.phases["left"] in {ServicePhase.SERVING, ServicePhase.SILENT}
        threading.Timer(0.1, service.stop).start()
        service.wait(60.0)
    assert recording.rate == pytest.approx(250.0)
    phases = [phase for arm, phase in told if arm == "left" and phase]
    assert phases[:5] == ["loading", "compiling", "waiting", "preparing", "serving"]
    assert "serving" in {status["phase"] for status in shown}
    assert before == (sys.getswitchinterval(), signal.getsignal(signal.SIGTERM), gc.isenabled())


@sampled("thread", ["limo-join_0", "limo-a", "limo-status"], "starts a service each")
def test_ctrl_c_while_a_thread_is_started_leaves_none(ends, tmp_path, monkeypatch, thread):
    """A thread that nobody ends would keep the process from ending."""
    started = threading.Thread.start

    def start(self):
        started(self)
        if self.name == thread:
            interrupted.append(thread)
            signal.raise_signal(signal.SIGINT)

    interrupted = []
    monkeypatch.setattr(threading.Thread, "start", start)
    others = set(threading.enumerate())
    with (
        pytest.raises(KeyboardInterrupt),
        limo.serve("a", store=tmp_path, simulation=BELIEVED, config=ends[0]),
    ):
        pytest.fail("nothing was interrupted")
    assert interrupted == [thread]
    left = set(threading.enumerate()) - others
    assert not [one.name for one in left if one.name.startswith("limo")]


def test_waiting_ends_by_a_signal_by_stop_and_in_time(ends, tmp_path):
    main = threading.get_ident()
    with limo.serve("a", store=tmp_path, simulation=BELIEVED, config=ends[0]) as service:
        for number in (signal.SIGTERM, signal.SIGINT):
            threading.Timer(0.05, signal.pthread_kill, (main, number)).start()
            service.wait(60.0)
        service.stop()  # is heard by who waits later, too
        service.wait(60.0)
        service.wait(0.05)
        waiting = threading.Thread(target=service.wait)  # elsewhere than in the main thread
        waiting.start()
        service.stop()
        waiting.join(60.0)
        assert not waiting.is_alive()
    service.stop()


def test_what_ends_the_telling_is_raised_by_who_waits(ends, tmp_path):
    def show(_status):
        raise BrokenPipeError

    with (
        pytest.raises(BrokenPipeError),
        limo.serve("a", store=tmp_path, simulation=BELIEVED, config=ends[0], show=show) as service,
    ):
        service.wait(60.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"arms": ()}, "no arm is named"),
        ({"store": None}, "one of them"),
        ({"model": "model"}, "brings its own simulation"),
        ({"retraining": RetrainingSettings()}, "needs `store` for the models and `log`"),
        (
            {"arms": {"a": "s", "b": "s"}, "log": "l", "retraining": RetrainingSettings()},
            "arms a and b share the store",
        ),
        (
            {"settings": ServiceSettings(contact_torque=(4.0, 4.0))},
            "`contact_torque` has 2 values, expected one, or one for each of the 7 joints of a",
        ),
    ],
)
def test_what_cannot_be_served_is_refused(options, message, ends, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    usual = {"arms": "a", "store": "models", "simulation": BELIEVED, "config": ends[0]}
    with pytest.raises(ConfigError, match=message), limo.serve(**usual | options):
        pass


def test_an_arm_without_a_torque_limit_is_served_with_a_bound(ends, tmp_path, two_links_urdf):
    """A tenth of no limit would be no bound, or one of 0."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(two_links_urdf.read_text().replace('effort="50"', 'effort="0"', 1))
    serve = partial(
        limo.serve, "a", store=tmp_path / "models", simulation=limo.Simulation(str(urdf)),
        config=ends[0],
    )  # fmt: skip
    with pytest.raises(ConfigError, match=r"a: no torque limit .* joint 1, .*`bound`"), serve():
        pass
    with serve(settings=ServiceSettings(bound=2.0)) as service:
        assert service.phases == {"a": ServicePhase.WAITING}
