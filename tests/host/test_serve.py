"""A host that is killed, freezes and restarts; its lease, scenes, accounts and settings."""

from __future__ import annotations

import os
import signal
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers import (
    EMERGENCY_STOP,
    DriverError,
    FaultLatched,
    LeaseRefused,
    LifecycleError,
    LinkLost,
    ResetRequest,
    make_driver,
)
from drivers.remote import ZenohDriver
from drivers.remote.messages import ArmRequest, Empty, Leased, LeaseRequest
from drivers.wire import pack
from iher_robot.env.controller import make_controller
from tests.served.observer import Observer
from tests.served.served_robot import PATIENT, ServedRobot, eventually, free_port, is_running

pytestmark = pytest.mark.real_time


@pytest.fixture
def served(tmp_path: Path) -> Iterator[ServedRobot]:
    """A host of its own, for tests that freeze it."""
    with ServedRobot(tmp_path / "memory", *PATIENT) as host:
        yield host


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedRobot]:
    with ServedRobot(tmp_path_factory.mktemp("memory"), *PATIENT) as host:
        yield host


@pytest.fixture
def shared(host: ServedRobot) -> Iterator[ServedRobot]:
    """A host that other tests use, too: each leaves it free and without a fault."""
    yield host
    for driver in host.drivers:
        driver.close()
    with Observer(host.endpoint) as observer:
        assert eventually(lambda: observer.newest[1].token == 0)
        fault = observer.newest[1].fault
    if fault is not None:
        host.driver().clear_fault(fault.name)


def _begin(driver: ZenohDriver) -> None:
    driver.open()
    driver.reset(ResetRequest())
    driver.arm()


def _advance_three_times(driver: ZenohDriver) -> None:
    for _ in range(3):  # a state may still be in transit
        driver.advance()


def test_a_host_that_is_killed_is_a_lost_link_and_its_robot_comes_back(tmp_path: Path) -> None:
    port = free_port()
    first = ServedRobot(tmp_path, port=port)
    first.start()
    processes = [first.pid, first.child("run_robot"), first.child("run_gateway")]
    driver = first.driver()
    _begin(driver)
    driver.advance()
    seq = driver.read().seq
    first.kill()
    with pytest.raises(LinkLost):
        _advance_three_times(driver)
    assert not driver.is_armed
    driver.close()
    assert eventually(lambda: not any(map(is_running, processes))), (
        "no process of a killed host keeps running"
    )
    with ServedRobot(tmp_path, port=port) as second:
        _begin(driver)
        driver.advance()
        assert driver.read().seq > seq, "the tick counter never falls, also over a restart"
        driver.close()
        assert second.output


def test_a_host_that_is_frozen_is_a_lost_link_within_the_time_out(served: ServedRobot) -> None:
    driver = served.driver(timeout_s=1.0)
    _begin(driver)
    robot = served.child("run_robot")
    served.signal(signal.SIGSTOP)  # the watchdog first, so that it does not intervene
    os.kill(robot, signal.SIGSTOP)
    try:
        with pytest.raises(LinkLost, match="iher-robot doctor"):
            _advance_three_times(driver)
        driver.disarm()
        driver.close()
    finally:
        os.kill(robot, signal.SIGCONT)
        served.signal(signal.SIGCONT)


def test_a_frozen_control_loop_is_ended_and_the_fault_latched(tmp_path: Path) -> None:
    port = free_port()
    first = ServedRobot(tmp_path, port=port)
    first.start()
    driver = first.driver()
    _begin(driver)
    robot = first.child("run_robot")
    os.kill(robot, signal.SIGSTOP)
    assert first.wait() == 2
    assert any("frozen" in line and "clear-fault watchdog" in line for line in first.output)
    assert not is_running(robot)
    driver.close()
    with ServedRobot(tmp_path, port=port) as second:
        again = second.driver()
        again.open()
        with pytest.raises(FaultLatched, match="frozen"):
            again.arm()
        again.clear_fault("watchdog")
        assert not again.is_armed
        again.arm()
        again.close()


def test_without_its_watchdog_nothing_moves(served: ServedRobot) -> None:
    driver = served.driver()
    _begin(driver)
    served.signal(signal.SIGSTOP)
    try:
        for _ in range(60):
            if not driver.is_armed:
                break
            driver.advance()
        assert not driver.is_armed
        assert "watchdog" in driver.disarmed_because
    finally:
        served.signal(signal.SIGCONT)
        driver.close()


def test_a_stop_outlives_host_and_client(tmp_path: Path) -> None:
    port = free_port()
    with ServedRobot(tmp_path, port=port) as first:
        driver = first.driver()
        _begin(driver)
        driver.stop("someone walked in")
        first.kill()
    with ServedRobot(tmp_path, port=port) as second:
        with Observer(second.endpoint) as observer:
            assert observer.newest[0].fault == EMERGENCY_STOP
        other = second.driver()
        other.open()
        with pytest.raises(FaultLatched, match="someone walked in"):
            other.arm()
        with pytest.raises(LifecycleError):
            other.clear_fault("another")
        other.clear_fault(EMERGENCY_STOP)
        assert not other.is_armed, "clearing never arms"
        other.arm()
        other.close()


def test_a_stop_of_one_client_stops_the_robot_of_another(shared: ServedRobot) -> None:
    driver, other = shared.driver(), shared.driver()
    _begin(driver)
    other.stop("pressed elsewhere")  # closed, without a lease
    driver.advance()
    assert eventually(lambda: driver.fault is not None)
    assert not driver.is_armed
    other.clear_fault(EMERGENCY_STOP)
    assert eventually(lambda: driver.fault is None), "a fault is cleared for all clients"
    driver.close()


def test_one_client_at_a_time(shared: ServedRobot) -> None:
    driver = shared.driver()
    driver.open()
    second = shared.driver(connect_timeout_s=0.5)
    with pytest.raises(LeaseRefused, match="is used by"):
        second.open()
    assert not second.is_open
    driver.arm()
    driver.advance()
    assert driver.is_armed, "a refused client does not affect the one with the lease"
    driver.close()
    second.open()
    second.close()


def test_a_stale_lease_expires_and_its_token_is_refused(shared: ServedRobot) -> None:
    with Observer(shared.endpoint) as observer:
        ask = observer.client.request
        request = {"session": "a client that never renews", "holder": "a test", "scene": "push"}
        reply = ask("lease", LeaseRequest(op="acquire", **request), 60.0)  # type: ignore[arg-type]
        old = Leased(boot=reply.boot, token=reply.result["token"])
        ask("disarm", old)
        assert eventually(lambda: observer.newest[1].token == 0), "a silent client loses its lease"
        driver = shared.driver()
        driver.open()
        for name, message in (
            ("disarm", old),
            ("arm", ArmRequest(boot=old.boot, token=old.token)),
            ("lease", LeaseRequest(op="renew", token=old.token, **request)),  # type: ignore[arg-type]
        ):
            with pytest.raises(LeaseRefused):
                ask(name, message)
        with pytest.raises(LinkLost, match="restarted"):
            ask("arm", ArmRequest(boot="an earlier start", token=observer.newest[1].token))
        assert not observer.newest[1].armed
        driver.close()


def test_unknown_requests_and_scenes_are_refused(shared: ServedRobot) -> None:
    with Observer(shared.endpoint) as observer:
        with pytest.raises(DriverError, match=r"unknown|does not answer"):
            observer.client.request("self_destruct", Empty())
        with pytest.raises(DriverError, match="scene"):
            shared.driver("no such scene")


def test_a_host_serves_the_scene_that_the_task_needs(shared: ServedRobot) -> None:
    for scene in ("reach", "push", "reach"):
        driver = shared.driver(scene)
        assert driver.spec.to_dict() == make_driver("mujoco", scene=scene).spec.to_dict()
        _begin(driver)
        assert driver.read().objects.keys() == driver.spec.objects.keys()
        np.testing.assert_allclose(driver.read().ee_pos, driver.spec.home.ee_pos, atol=0.01)
        driver.close()


def test_a_scene_is_not_loaded_while_the_robot_moves(shared: ServedRobot) -> None:
    driver = shared.driver()
    _begin(driver)
    driver.advance()
    with pytest.raises(LeaseRefused, match="not loaded"):
        shared.driver("slide")
    driver.advance()
    assert driver.is_armed
    driver.disarm()
    assert shared.driver("slide").spec.name.endswith("slide")
    driver.close()


def test_the_robots_side_counts_every_tick_of_motion(shared: ServedRobot) -> None:
    def total() -> Counter[str]:
        with Observer(shared.endpoint) as observer:
            return Counter(observer.client.request("status", Empty()).result["total_ticks"])

    earlier = total()
    driver = shared.driver()
    _begin(driver)
    before = driver.read().seq
    for _ in range(60):
        driver.advance()
    after = driver.read().seq
    driver.close()
    spent = total() - earlier
    assert after - before <= spent["motion"] <= after - before + 10
    assert spent["reset"] >= 1


def test_a_slow_speed_is_kept_on_the_robots_side(shared: ServedRobot) -> None:
    driver = shared.driver()
    controller = make_controller(driver.spec, True)
    driver.open()
    driver.reset(ResetRequest())
    driver.limit_speed(0.2)
    driver.arm()
    most = 0.0
    for _ in range(20):
        state = driver.read()
        driver.command(controller.command(np.array([0.0, 1.0, 0.5, 0.0]), state))
        driver.advance()
        most = max(most, float(np.linalg.norm(driver.read().ee_linvel)))
    driver.close()
    limit = 0.2 * driver.spec.limits.max_ee_speed_m_s
    assert 0.2 * limit < most <= 1.15 * limit


def test_poses_from_another_publisher(tmp_path: Path) -> None:
    with ServedRobot(tmp_path, "--perception", "object0") as served:
        driver = served.driver()
        assert driver.spec.objects["object0"].source == "perception"
        driver.open()
        with pytest.raises(DriverError, match=r"no pose of object0 .* was received yet"):
            driver.read()
        with Observer(served.endpoint) as camera:
            publisher = camera.client._session.declare_publisher("iher/v1/fetch/object/object0")

            def send(n: int, x: float, frame: str = "world", age_s: float = 0.0) -> None:
                zero = np.zeros(3)
                pose = {"pos": np.array([x, 0.7, 0.42]), "quat": np.array([1.0, 0, 0, 0])}
                pose |= {"linvel": zero, "angvel": zero}
                content = {"v": 1, "n": n, "age_s": age_s, "frame": frame}
                publisher.put(pack(content | pose))

            send(1, 1.3)
            assert eventually(lambda: driver._newest.value[0].objects.get("object0") is not None)  # type: ignore[index]
            pose = driver.read().objects["object0"]
            assert (pose.pos[0], pose.source) == (1.3, "perception")
            send(2, 1.4)
            send(1, 9.9)  # late
            send(3, 9.9, frame="camera")
            assert eventually(lambda: driver.read().objects["object0"].pos[0] == 1.4)
            driver.advance()
            assert driver.read().objects["object0"].pos[0] == 1.4, (
                "late poses, and those in another frame, are dropped"
            )
            send(4, 1.5, age_s=30.0)
            assert eventually(lambda: driver._newest.value[0].objects["object0"].pos[0] == 1.5)  # type: ignore[index]
            with pytest.raises(DriverError, match="object 'object0'"):
                driver.read()
        driver.close()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--robot", "fetch-mocap"), "enforces no joint limits"),
        (("--listen", "tcp/0.0.0.0:7999"), "insecure"),
        (("--deadman", "0"), "deadman"),
        (("--perception", "cup"), "cup"),
        (("--name", "Fetch!"), "robot name"),
        (("--driver", "zenoh"), "zenoh"),
    ],
)
def test_a_host_refuses_settings_with_the_reason(
    tmp_path: Path, options: tuple[str, ...], sentence: str
) -> None:
    host = ServedRobot(tmp_path, *options)
    with pytest.raises(AssertionError, match=sentence):
        host.start()
    assert host.wait() == 2


def test_requests_from_many_threads_are_answered(shared: ServedRobot) -> None:
    with Observer(shared.endpoint) as observer:
        answers: list[str] = []

        def ask() -> None:
            for _ in range(20):
                answers.append(observer.client.request("status", Empty()).boot)

        threads = [threading.Thread(target=ask) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30.0)
        assert answers == [answers[0]] * 80
