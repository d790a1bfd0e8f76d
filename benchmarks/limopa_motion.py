"""What the motion of `limo plan` is like, and what planning costs, arm by arm.

    python benchmarks/limopa_motion.py [--scaffolds 150] [--seed 1] [ROBOT ...]
    python benchmarks/limopa_motion.py --picture docs/limopa.png

Each arm is planned for with its collision shapes and a table, with a probe of 0.2 m at its flange,
without the table, and without shapes; each in a process of its own, whose processor time and peak
memory are those of planning, what is compiled the first time included. The UR10e is the one of
`$LIMO_DATA`, whose meshes are not there; so the UR10 is planned for, too. The MJCF is a UR5 that
limo exports, with capsules around its meshes, 5 cm above its table. Then `limo plan` is asked for
what cannot be; a message has to come within 10 s of processor time and to name the option.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from importlib.metadata import files
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np

import limo_driver as limo
from limo_driver.runtime.compiled import compiled
from limo_driver.types import Motion
from limopa import Feasibility, PlanRequest, Surroundings, plan, summarise
from limopa.distances import ways
from limopa.planner import EXPLORING, REACHING, path_deviation, rotations

if TYPE_CHECKING:
    from limo_driver.trajectory import Trajectory
    from limo_driver.types import FloatArray
    from limopa import Plan

ROBOTS = {
    "iiwa14": "iiwa14",
    "panda": "panda.urdf",
    "ur10e": "ur10e/ur10e.urdf",
    "ur10": "ur10_robot.urdf",
    "so101": "so101.urdf",
    "ur5 (MJCF)": "ur5_robot.urdf",
}
SHAPES, TOOL, NO_TABLE, NO_SHAPES = "shapes, table", "with a probe", "no table", "no shapes"
SMALL = np.radians(10.0)  # the interval in which hysteresis loops do not saturate
LOW = Surroundings(table_height=-10.0)
PROBE = """<link name="probe"><inertial><origin xyz="0 0 0.1"/><mass value="0.3"/>
<inertia ixx="1e-3" iyy="1e-3" izz="2e-4" ixy="0" ixz="0" iyz="0"/></inertial><collision>
<origin xyz="0 0 0.1"/><geometry><cylinder radius="0.02" length="0.2"/></geometry></collision>
</link>"""
FAR = {  # what is asked for in vain, and the option that has to be named
    "--table-height": "0.9",
    "--workspace-radius": "0.05",  # a UR10e plans within 0.1 m
    "--region": "3,0,0,3.5,0.5,0.5",
    "--clearance": "0.5",
    "--joint-margin": "160",
}
HEADINGS = {
    "reversals while exploring": {
        "per minute": "of each joint", "interval [deg]": "10, 50, 90 %", "< 10 deg": "share",
        "isotropy": "1: as much either way", "reaching": "the same there",
    },
    "coverage, speeds": {
        "joints [%]": "of ranges", "workspace [%]": "exploring", "joints [% of limit]": "50, 99 %",
        "probe [m/s]": "50, 99 %", "condition": "base parameters",
    },
    "distances": {
        "links [mm]": "least", "table [mm]": "least", "off the path [rad]": "most",
        "of a limit": "most",
    },
    "planning": {
        "processor [s]": "bar 60", "memory [GB]": "peak", "motion [h]": "paper 1",
        "waypoints": "paper 337500", "drawn": "",
    },
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """An arm, and what is around it."""

    robot: str
    variant: str

    def surroundings(self) -> Surroundings:
        """Return what is kept away from."""
        shapes = self.robot != "ur10e" and self.variant != NO_SHAPES
        table = Surroundings(table_height=-0.05 if "MJCF" in self.robot else 0.0)
        around = LOW if self.variant == NO_TABLE else table
        return replace(around, self_collision=shapes)


def description(robot: str, folder: Path, *, probe: bool = False) -> str:
    """Return the name or file of an arm; what is made of it lies in a folder."""
    source = ROBOTS[robot]
    path = Path(os.environ.get("LIMO_DATA", "../shared/data")) / source
    if not path.exists():
        known = (item for item in files("example-robot-data") or () if item.name == source)
        path = next((Path(str(item.locate())).resolve() for item in known), Path(source))
    if probe:
        model = limo.RobotModel.load(str(path))
        root = ET.parse(model.urdf).getroot()  # noqa: S314  # of this package or the user's
        for mesh in root.iter("mesh"):
            name = mesh.attrib["filename"].partition("://")[2] or mesh.attrib["filename"]
            above = (folder / name for folder in Path(model.urdf).resolve().parents)
            mesh.attrib["filename"] = str(next((at for at in above if at.exists()), name))
        root.append(ET.fromstring(PROBE))  # noqa: S314
        at = f'<joint name="mount" type="fixed"><parent link="{model.flange}"/>'
        root.append(ET.fromstring(f'{at}<child link="probe"/></joint>'))  # noqa: S314
        path = folder / f"{model.name}.urdf"
        path.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
    return str(path) if "MJCF" not in robot else str(_as_mjcf(str(path), folder))


def _as_mjcf(path: str, folder: Path) -> Path:
    """Write an arm as MJCF, with capsules around its meshes, which an export leaves out."""
    model = limo.RobotModel.load(path)
    written = limo.export(limo.Simulation(path), "mjcf", folder / "mjcf").file
    tree = ET.parse(written)  # noqa: S314
    for body in tree.iter("body"):
        joint = body.find("joint")
        name = "" if joint is None else joint.get("name")
        for capsule in model.capsules():
            if capsule.joint >= 0 and model.joint_names[capsule.joint] == name:
                ends = " ".join(f"{x:.9g}" for x in (*capsule.start, *capsule.end))
                shape = {"type": "capsule", "fromto": ends, "size": f"{capsule.radius:.9g}"}
                body.append(ET.Element("geom", shape | {"mass": "0"}))
    tree.write(written)
    return written


def attempted(case: Case, scaffolds: int, seed: int) -> list[dict[str, str]] | str:
    """Return the figures of a case, or why it cannot be planned."""
    try:
        return measured(case, scaffolds, seed)
    except limo.LimoError as error:
        return str(error)


def measured(case: Case, scaffolds: int, seed: int) -> list[dict[str, str]]:
    """Plan, and return the figures, a table each; in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        model = limo.RobotModel.load(
            description(case.robot, Path(folder), probe=case.variant == TOOL)
        )
        begin = _processor(resource.RUSAGE_SELF)
        planned = plan(
            model, PlanRequest(scaffolds=scaffolds, surroundings=case.surroundings()), seed
        )
        cost = _processor(resource.RUSAGE_SELF) - begin
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        summary = summarise(planned, model)
        motion, joints = planned.trajectory, range(model.n)
        exploring = [slice(s.start, s.stop) for s in motion.segments if s.kind == EXPLORING]
        reaching = [slice(s.start, s.stop) for s in motion.segments if s.kind == REACHING]
        minutes = summary.exploring_duration.mean * len(exploring) / 60
        intervals = np.degrees(np.concatenate([
            rotations(motion.position[rows, j], motion.velocity[rows, j])
            for rows in exploring for j in joints
        ]))  # fmt: skip
        rows = np.concatenate([np.arange(r.start, r.stop) for r in exploring])
        share = 100 * np.abs(motion.velocity[rows]) / model.limits.velocity
        space = Feasibility(model, planned.request.surroundings, planned.request.workspace)
        speed = ways(space.chain, motion.position)[rows[1:] - 1] * planned.request.rate
        peaks = motion.peaks().over(model.limits)
        largest = np.max([peaks.velocity, peaks.acceleration, peaks.jerk])
        return [
            {
                "per minute": _span([j.reversals / minutes for j in summary.joints], ".1f"),
                "interval [deg]": _quantiles(intervals, (0.1, 0.5, 0.9), ".1f"),
                "< 10 deg": f"{np.mean(intervals < np.degrees(SMALL)):.0%}",
                "isotropy": _span([isotropy(motion, exploring, j) for j in joints], ".2f"),
                "reaching": _span([isotropy(motion, reaching, j) for j in joints], ".2f"),
            },
            {
                "joints [%]": _span([100 * j.coverage for j in summary.joints], ".0f"),
                "workspace [%]": f"{100 * covered(planned, space, rows):.0f}",
                "joints [% of limit]": _quantiles(share, (0.5, 0.99), ".1f"),
                "probe [m/s]": _quantiles(speed, (0.5, 0.99), ".2f"),
                "condition": f"{condition(model, motion):.0f}",
            },
            {
                **_distances(space, motion),
                "off the path [rad]": f"{_off(planned):.1e}",
                "of a limit": f"{largest:.2f}",
            },
            {
                "processor [s]": f"{cost:.1f}",
                "memory [GB]": f"{memory:.2f}",
                "motion [h]": f"{summary.duration / 3600:.2f}",
                "waypoints": str(summary.waypoints),
                "drawn": str(planned.candidates),
            },
        ]


def isotropy(motion: Trajectory, phases: list[slice], joint: int) -> float:
    """Return how much of a joint's travel within small intervals is as much in either direction.

    Each phase is cut where the joint has left an interval of 10 degrees. In a piece, twice the
    travel in the rarer direction is isotropic; 1 is all of it, and 0 a joint that turns one way.
    """
    parts = np.array([two_way(motion.position[rows, joint].copy(), SMALL) for rows in phases])
    return float(parts[:, 0].sum() / max(parts[:, 1].sum(), 1e-12)) if len(parts) else np.nan


@compiled(reads=("position",))
def two_way(position: FloatArray, interval: float) -> tuple[float, float]:
    """Return the travel, (T,) [rad], that is matched by some the other way nearby, and all."""
    low = high = position[0]
    up = down = matched = whole = 0.0
    for k in range(1, len(position)):
        step = position[k] - position[k - 1]
        low, high = min(low, position[k]), max(high, position[k])
        if step > 0:
            up += step
        else:
            down -= step
        if high - low > interval or k == len(position) - 1:
            matched += 2 * min(up, down)
            whole += up + down
            low = high = position[k]
            up = down = 0.0
    return matched, whole


def covered(planned: Plan, space: Feasibility, rows: FloatArray) -> float:
    """Return the share of cells that the flange can be in at which it is explored.

    A cell is an eighth of the reach wide; what it can be in is found by 50 000 random poses.
    """
    random = np.random.default_rng(0).uniform(space.lower, space.upper, (50_000, len(space.lower)))
    possible = random[space.check_scaffold(random, all_of=False).feasible]
    flange = space.chain.flange_position(possible)
    width = np.linalg.norm(flange, axis=1).max() / 8
    cells = {tuple(cell) for cell in np.floor(flange / width).astype(int)}
    seen = space.chain.flange_position(planned.trajectory.position[rows[::5]])
    return len(cells & {tuple(cell) for cell in np.floor(seen / width).astype(int)}) / len(cells)


def condition(model: limo.RobotModel, motion: Trajectory) -> float:
    """Return the condition number of the base parameters, friction included, SI units."""
    from estimators.rigid_body.base_parameters import Conditioning

    few = slice(None, None, 10)
    states = (motion.time, motion.position, motion.velocity, motion.acceleration)
    return Conditioning(model).condition(Motion(*(np.array(x[few]) for x in states)))


def _distances(space: Feasibility, motion: Trajectory) -> dict[str, str]:
    gap, lowest = space.clearances(motion.position[::10])
    table = lowest.min() - space.surroundings.table_height
    far = space.surroundings.table_height < LOW.table_height / 2
    return {
        "links [mm]": f"{1e3 * gap.min():.0f}" if gap.size else "-",
        "table [mm]": "-" if far else f"{1e3 * table:.0f}",
    }


def _off(planned: Plan) -> float:
    """Return how far any exploring phase leaves its sinusoids [rad], seen at 1 kHz."""
    pairs = zip(planned.phases, planned.trajectory.segments, strict=True)
    return max(
        path_deviation(planned, phase, slice(segment.start, segment.stop))
        for phase, segment in pairs
        if phase.kind == EXPLORING
    )


def _span(values: list[float], form: str) -> str:
    return f"{min(values):{form}}-{max(values):{form}}"


def _quantiles(values: FloatArray, shares: tuple[float, ...], form: str) -> str:
    return " ".join(f"{value:{form}}" for value in np.quantile(values, shares))


def _processor(whose: int) -> float:
    used = resource.getrusage(whose)
    return used.ru_utime + used.ru_stime


def refused(robot: str, option: str, value: str) -> str:
    """Return how long `limo plan` takes to say that something cannot be, and what it names."""
    with tempfile.TemporaryDirectory() as folder:
        arm = description(robot, Path(folder))
        shapes = ["--no-self-collision"] if robot == "ur10e" else []
        program = str(Path(sys.executable).with_name("limo"))
        out = f"{folder}/a.traj.parquet"
        begin = _processor(resource.RUSAGE_CHILDREN)
        done = subprocess.run(  # the command under test
            [program, "plan", "--robot", arm, "--out", out, *shapes, option, value],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
    seconds = _processor(resource.RUSAGE_CHILDREN) - begin
    if not done.returncode:
        return "planned"
    named = re.findall(r"--(?!no-)[a-z][a-z-]+", done.stderr)
    verdict = "" if option in named and len(done.stderr.splitlines()) == 1 else " MISSED"
    return f"{seconds:5.1f} s, names {' '.join(dict.fromkeys(named)) or 'none'}{verdict}"


def picture(path: Path) -> None:
    """Draw a joint that reaches poses, and the same as it explores one."""
    from matplotlib.figure import Figure

    planned = plan(limo.RobotModel.load("iiwa14"), PlanRequest(scaffolds=8), seed=1)
    motion, joint = planned.trajectory, 1
    figure = Figure(figsize=(9.0, 4.4), dpi=120, layout="constrained")
    axes = figure.subplots(2, 2, gridspec_kw={"height_ratios": (1.5, 1)})
    kinds = {REACHING: "Reaching: one direction", EXPLORING: "Exploring: locally isotropic"}
    for column, (kind, title) in zip(axes.T, kinds.items(), strict=True):
        phases = [slice(s.start, s.stop) for s in motion.segments if s.kind == kind]
        rows = max(phases, key=lambda rows: np.ptp(motion.position[rows, joint]))
        value = isotropy(motion, [rows], joint)
        q, time = np.degrees(motion.position[rows, joint]), motion.time[rows]
        step = np.diff(q, append=q[-1])
        at = np.arange(np.floor(q.min()), q.max() + 1)
        for sign, colour, label in ((1, "#0b559f", "travel up"), (-1, "#c1272d", "travel down")):
            own = sign * step > 0
            column[0].plot(time - time[0], np.where(own, q, np.nan), color=colour)
            travel, _ = np.histogram(q, np.append(at, at[-1] + 1), weights=np.where(own, step, 0))
            column[1].bar(at + 0.5, travel, width=0.9, color=colour, label=label)
        column[0].set(title=f"{title} (isotropy {value:.2f})", xlabel="time [s]")
        column[1].axhline(0.0, color="black", linewidth=0.6)
        column[1].set_xlabel("position [deg]")
    axes[0, 0].set_ylabel("joint 2 [deg]")
    axes[1, 0].set_ylabel("travel by degree [deg]")
    axes[1, 1].legend(frameon=False, fontsize=7)
    for ax in axes.flat:
        ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)


def main() -> None:
    """Plan for each arm and around it, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("robots", nargs="*", help=", ".join(ROBOTS))
    parser.add_argument("--scaffolds", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--picture", type=Path, help="only draw what this motion is")
    asked: Any = parser.parse_args()
    if asked.picture:
        picture(asked.picture)
        return
    robots = asked.robots or list(ROBOTS)
    cases = [Case(robot, v) for robot in robots for v in (SHAPES, TOOL, NO_TABLE, NO_SHAPES)]
    cases = [case for case in cases if case != Case("ur10e", NO_SHAPES)]  # it has none anyway
    found: dict[Case, list[dict[str, str]] | str] = {}
    for case in cases:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            found[case] = pool.submit(attempted, case, asked.scaffolds, asked.seed).result()
        print(f"{case.robot}, {case.variant}", file=sys.stderr)
    print(f"{asked.scaffolds} scaffolds, seed {asked.seed}")
    for case, why in found.items():
        if isinstance(why, str):
            print(f"no plan for {case.robot}, {case.variant}: {why}")
    for number, (title, columns) in enumerate(HEADINGS.items()):
        rows = [[title, *columns], ["", *columns.values()]]
        for case, tables in found.items():
            bare = case == Case("ur10e", SHAPES)
            if not isinstance(tables, str):
                name = f"{case.robot}, {NO_SHAPES if bare else case.variant}"
                rows.append([name, *tables[number].values()])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        print()
        for first, *others in rows:
            cells = (cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True))
            print("  ".join([first.ljust(widths[0]), *cells]).rstrip())
    print("\nasked in vain (bar 10 s of processor time, and the option named)")
    for robot in robots:
        for option, value in FAR.items():
            print(f"{robot:<12}{option + ' ' + value:<32}{refused(robot, option, value)}")


if __name__ == "__main__":
    main()
