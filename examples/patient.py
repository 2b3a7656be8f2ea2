"""A controller of your own, with a memory.

Try it: ``flipperctl eval patient terrain=step --plugins examples/patient.py``
"""

from pydantic import Field

from flipperctl.api import (
    Controller,
    Perception,
    Policy,
    Simulator,
    action_index,
    candidate_angle,
    controller,
)


@controller("patient")
class Patient(Controller):
    """Follow the ground with the front flippers, once a turn was wanted several times in a row."""

    margin: float = Field(0.1, ge=0, le=1, description="front flipper angle above the ground [rad]")
    patience: int = Field(2, ge=1, le=20, description="decisions in a row before a turn [-]")

    def build(self) -> Policy:
        return PatientPolicy(self)


class PatientPolicy:
    """The policy of one episode; it remembers the last wanted turn and how often it was wanted."""

    def __init__(self, settings: Patient) -> None:
        self._settings = settings
        self._asked, self._times = 0, 0

    def reset(self, simulator: Simulator) -> None:
        self._asked, self._times = 0, 0

    def act(self, p: Perception) -> int:
        wanted = candidate_angle(p.points, p.pitch, p.robot) + self._settings.margin
        turn = max(-1, min(1, round((wanted - p.front) / p.robot.angle_step)))
        self._times = self._times + 1 if turn == self._asked else 1
        self._asked = turn
        return action_index(turn if self._times >= self._settings.patience else 0, 0)
