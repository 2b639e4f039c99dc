"""The plant as a process: gives every arm its state, takes its torque, lets time pass.

In lockstep, time passes only as far as the torques are known.  What acts a delay after tick k does not depend on the
answers to tick k before that: so much the plant integrates while the agents compute.  Where that is the whole period it
tells them the state of k + 1 at once.  Nobody waits for what is known already, and the result is the same bit for bit.
"""

from __future__ import annotations

import contextlib
import gc
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from drivers.interface import Refusal, Vector
from sim_backend.physics.build import AnyPlant, snapshot
from sim_backend.physics.delay import DelayLine, stretches
from sim_backend.physics.snapshot import Observation, Snapshot
from sim_backend.physics.spec import WHOLE_SUBSTEPS_TOLERANCE, PlantError, substep_of
from sim_backend.served.instants import Instants
from sim_backend.served.listener import Listener
from sim_backend.served.lobby import Lobby
from sim_backend.served.options import ArmVanished, LostArm, ServerOptions, Summary
from sim_backend.served.protocol import MessageKind
from sim_backend.served.seat import WAIT_S, Attendance, Seat, Vanished

LOBBY_EVERY_TICKS: Final = 32  # in lockstep with all arms on, nobody else is in a hurry

OnTick = Callable[[int, int, Observation], None]  # tick, its stamp on the plant's clock, what is true then


def serve(
    plant: AnyPlant,
    options: ServerOptions,
    on_tick: OnTick | None = None,
    on_listening: Callable[[], None] | None = None,
) -> Summary:
    """Serve the plant until every arm has said BYE, `ticks` have passed, or `stop()` is true.

    on_tick(tick, stamp_ns, observation) is called from inside the tick, once everybody has been told what can be told,
    and must not block.  on_listening() is called once arms can connect.  Raises ArmVanished, PlantError; the socket is
    gone in every case.
    """
    with Listener(options.socket_path) as listener, _quiet_gc():
        server = _Server(plant, options, on_tick, listener)
        try:
            if on_listening is not None:
                on_listening()
            return server.run()
        except PlantError as error:
            server.look()
            server.tell_all(error)
            raise
        finally:
            server.close()


@contextlib.contextmanager
def _quiet_gc() -> Iterator[None]:
    """Nothing in a tick makes cycles; a collection would only make it late."""
    was_enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class _Server:
    def __init__(self, plant: AnyPlant, options: ServerOptions, on_tick: OnTick | None, listener: Listener) -> None:
        self._plant = plant
        self._options = options
        self._on_tick = on_tick
        self._substeps = _whole_substeps(plant, options)
        self._seats = tuple(
            Seat(arm, joints, DelayLine.of(arm.actuator, plant.spec.substep_s, self._substeps, seed))
            for seed, (arm, joints) in enumerate(zip(plant.spec.arms, plant.slices, strict=True))
        )
        info = {
            "lockstep": options.lockstep,
            "rate_hz": options.rate_hz,
            "utc_offset_ns": options.utc_offset_ns,
            "description": f"simulated plant at {options.socket_path}, {options.rate_hz:g} Hz",
        }
        self._lobby = Lobby(listener, self._seats, options.config_id, info, self._reply, self._lose)
        lines = [s.delay for s in self._seats]
        parts = stretches(lines, self._substeps)
        self._before_answers = tuple(part for part in parts if all(line.is_known(part[0]) for line in lines))
        self._after_answers = parts[len(self._before_answers) :]
        self._support_substeps = max(line.first_substep for line in lines) if options.supported_start and lines else 0
        self._tau, self._no_torque = np.zeros((2, plant.joint_count))
        self._tick = 0
        self._reached = 0  # tick whose state is known: the present one, or the next while answers are due
        self._instants = Instants(options)
        self._lost_arms: list[str] = []
        self._kept: tuple[int, int, Snapshot] | None = None  # tick and stamp of what on_tick is still to be told

    def run(self) -> Summary:
        while any(s.phase is not Attendance.ON for s in self._seats):
            if self._stopped():
                return self._summary(time.monotonic())
            self._lobby.attend(WAIT_S)
        self._lobby.started = True
        if any(s.guest for s in self._seats):
            self._plant.meter_grasps()
        self._instants.begin()
        begin = time.monotonic()
        while not self._over():
            self._one_tick()
        return self._summary(begin)

    def tell_all(self, refusal: Refusal) -> None:
        for seat in self._seats:
            seat.tell(refusal)

    def close(self) -> None:
        self._lobby.close()
        for seat in self._seats:
            seat.leave(Attendance.GONE)

    def _stopped(self) -> bool:
        if self._options.stop():
            self._end("a run that goes on")
            return True
        return False

    def _over(self) -> bool:
        if self._tick == self._options.ticks:
            self._end(f"a run of {self._options.ticks} ticks")
            return True
        return self._stopped() or all(s.phase in (Attendance.GONE, Attendance.ABSENT) for s in self._seats)

    def _end(self, expected: str) -> None:
        found = f"the plant ended at tick {self._tick}"
        self.tell_all(Refusal("the run is over", found=found, expected=expected, remedy="start a new run"))

    def _one_tick(self) -> None:
        everyone_on = all(s.phase is Attendance.ON for s in self._seats)
        if not (everyone_on and self._options.lockstep) or self._tick % LOBBY_EVERY_TICKS == 0:
            self._lobby.attend(0.0)
        on = [s for s in self._seats if s.phase is Attendance.ON]
        if self._options.lockstep and not on:  # time waits until somebody is there to see it
            self._lobby.attend(WAIT_S)
            return
        self._send(on)
        self._integrate(self._before_answers)
        if not self._after_answers:
            self._reached = self._tick + 1
            if self._options.lockstep and self._reached != self._options.ticks:
                self._send(on)
        self.look()
        self._collect(on)
        self._integrate(self._after_answers)
        self.look()
        self._tick += 1
        self._reached = self._tick

    def _send(self, on: list[Seat]) -> None:
        """Tell everyone the state of the last tick that is known, once."""
        tick = self._reached
        due = [s for s in on if s.told < tick]
        if not due:
            return
        reported = self._plant.reported()
        true = self._true(reported) if any(s.guest for s in due) else reported
        stamp_ns = self._instants.stamp_ns(tick)
        flags = 0 if self._options.lockstep else socket.MSG_DONTWAIT
        for seat in due:
            seat.told = tick
            seat.send_state(MessageKind.STATE, tick, stamp_ns, true if seat.guest else reported, flags)

    def _true(self, reported: Vector) -> Vector:
        """What a real arm's twin tells, which has no servos: true motion, and the grasps' torques of the last tick."""
        plant = self._plant
        return np.stack([plant.q, plant.dq, reported[2], plant.grasp_torque()])

    def _reply(self, seat: Seat) -> None:
        """Answer a POLL: the state now, under the number of the question."""
        stamp_ns = round(self._plant.t * 1e9) if self._options.lockstep else time.monotonic_ns()
        state = self._plant.reported()
        if seat.guest:
            state = np.stack([self._plant.q, self._plant.dq, state[2], np.zeros(self._plant.joint_count)])
        seat.send_state(MessageKind.REPLY, seat.number, stamp_ns, state, socket.MSG_DONTWAIT)

    def _integrate(self, parts: Sequence[tuple[int, int]]) -> None:
        """Let these parts of the tick pass: first substep and number of each."""
        tick, tau = self._tick, self._tau
        for begin, count in parts:
            for seat in self._seats:
                tau[seat.joints] = seat.delay.acting(tick, begin)
            if begin == 0 and self._on_tick is not None and tick % self._options.observe_every == 0:
                self._kept = tick, self._instants.stamp_ns(tick), snapshot(self._plant, tau)
                self._options.pause(self._kept[1])
            if tick * self._substeps + begin < self._support_substeps:
                self._plant.rest(count)
            else:
                self._plant.advance(tau, count)

    def look(self) -> None:
        """Tell on_tick of the last instant that was kept for it; working it out takes longer than the tick's motion."""
        if self._kept is not None and self._on_tick is not None:
            (tick, stamp_ns, kept), self._kept = self._kept, None
            self._on_tick(tick, stamp_ns, kept.observation())

    def _collect(self, on: list[Seat]) -> None:
        if not self._options.lockstep:
            self._instants.sleep_until(self._tick + 1)
        limp = self._plant.calendar.limp(self._tick * self._substeps)
        for seat in reversed(on):  # the last to be told answers last: who waits for it first is woken once
            if seat.limp_at_tick is not None and self._tick >= seat.limp_at_tick:
                seat.leave(Attendance.ABSENT)
                continue
            try:
                if self._options.lockstep:
                    self._wait_for_answer(seat)
                else:
                    self._take_newest(seat)
            except Vanished as e:
                self._lose(seat, e.reason)
            if seat.phase is Attendance.ON:
                seat.delay.push(self._tick, self._no_torque[seat.joints] if seat.arm.name in limp else seat.tau)

    def _wait_for_answer(self, seat: Seat) -> None:
        while (kind := seat.receive()) is None:
            if self._options.stop():
                return
            self._lobby.attend(0.0)
        if kind is not MessageKind.COMMAND:
            _dismiss(seat, kind)
        elif seat.number != self._tick:
            raise Vanished(f"it answered tick {seat.number} instead of {self._tick}")

    def _take_newest(self, seat: Seat) -> None:
        """Real time: the last command counts; without a new one the last torque stays, as on a servo."""
        while seat.phase is Attendance.ON and (kind := seat.receive(socket.MSG_DONTWAIT)) is not None:
            if kind is not MessageKind.COMMAND:
                _dismiss(seat, kind)

    def _lose(self, seat: Seat, reason: str) -> None:
        name = seat.arm.name
        if seat.watchdog_s is not None:
            self._lost_arms.append(name)
            if seat.phase is Attendance.ON and self._lobby.started:
                seat.orphan(self._tick + round(seat.watchdog_s * self._options.rate_hz))
            else:
                seat.leave(Attendance.ABSENT)
            return
        seat.leave(Attendance.ABSENT)
        if self._options.lost_arm is LostArm.END_RUN:
            raise ArmVanished(name, self._tick, reason)
        self._lost_arms.append(name)

    def _summary(self, begin_s: float) -> Summary:
        return Summary(
            ticks=self._tick,
            sim_s=self._tick / self._options.rate_hz,
            wall_s=time.monotonic() - begin_s,
            late_ticks=self._instants.late,
            dropped_states=sum(s.dropped_states for s in self._seats),
            lost_arms=tuple(self._lost_arms),
        )


def _dismiss(seat: Seat, kind: MessageKind) -> None:
    """Take leave of an arm in the place of its answer.  Raises Vanished on anything else."""
    if kind is MessageKind.DISABLE:
        seat.switch_off()
    elif kind is MessageKind.BYE:
        seat.leave(Attendance.GONE)
    else:
        raise Vanished(f"it said {kind.name} out of turn")


def _whole_substeps(plant: AnyPlant, options: ServerOptions) -> int:
    period_s, h = 1.0 / options.rate_hz, plant.spec.substep_s
    count = round(period_s / h)
    if count < 1 or abs(count * h / period_s - 1) > WHOLE_SUBSTEPS_TOLERANCE:
        raise PlantError(
            "substep_s",
            found=f"{h:g} s at {options.rate_hz:g} Hz",
            expected=f"a whole number of substeps in {period_s:g} s",
            remedy=f"use {substep_of(period_s):.12g} s (sim_backend.physics.spec.substep_of)",
        )
    return count
