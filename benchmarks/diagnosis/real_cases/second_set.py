"""A second set of real recordings with known physics, from sources that no setting has seen.

Rebuilds the cases of `second_set.yaml` from a folder of fetched sources; nothing of the sources is
kept here. Each case is a folder as `real_cases` of the first set has it: `robot.urdf`, `sim.yaml`
(what one would believe), `recording*.parquet`, `heldout*.parquet` and `truth.json` (what has to be
named, may be named as well, and must not be), so that the first set's scorer works on both.

    python benchmarks/diagnosis/real_cases/second_set.py files
    python benchmarks/diagnosis/real_cases/second_set.py build SOURCES CASES [--only NAME...]
    python benchmarks/diagnosis/real_cases/second_set.py values CASES OUT

`files` prints what has to lie in SOURCES/OWNER+NAME/, `values` what `limo diagnose` wrote into
OUT/CASE/verdict.json beside the values that are known.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io
import yaml
from scipy.signal import butter, filtfilt

if TYPE_CHECKING:
    from collections.abc import Iterator

    Table = tuple[np.ndarray, np.ndarray, np.ndarray]  # time (T,), position, torque (T, n)

TABLE: dict[str, Any] = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))
EXAMPLE_ROBOTS = Path(pinocchio.__file__).parents[4] / "share/example-robot-data/robots"
BANDWIDTH = 8.0  # [Hz] of the speed that tells which rows move
PARAMETERS = {  # of a simulation in the table: effect, parameter
    "f_v": ("viscous_friction", "f_v"),
    "armature": ("armature", "inertia"),
    "offset": ("torque_offset", "offset"),
}


# ------------------------------------------------------------------ recordings
def paths(read: dict[str, Any], run: str) -> list[str]:
    """Return the files of a run, in the order of the names that a reader has."""
    pattern = str(
        next(read[kind] for kind in ("csv", "texts", "mat", "volts", "npz") if kind in read)
    )
    names = read.get("names", [""]) if "{name}" in pattern else [""]
    return [pattern.format(run=run, name=name) for name in names]


def recording(read: dict[str, Any], folder: Path, run: str) -> Table:
    """Return a run in s, rad and N m; columns are those of time, first position, first torque."""
    files, joints = [folder / path for path in paths(read, run)], read.get("joints", 1)
    if "csv" in read or "mat" in read:
        data = (
            np.loadtxt(files[0], delimiter=",", skiprows=read["header"])
            if "csv" in read
            else scipy.io.loadmat(files[0])["data"]
        )
        time, q, tau = read["columns"]
        found = [data[:, time], data[:, q : q + joints], data[:, tau : tau + joints]]
    elif "texts" in read:
        found = [
            np.loadtxt(file).reshape(-1, width)
            for file, width in zip(files, (1, joints, joints), strict=True)
        ]
    elif "npz" in read:
        found = [np.load(files[0])[name] for name in read["names"]]
    else:
        found = from_volts(*(scipy.io.loadmat(file)[f"data_{file.stem[5:]}"] for file in files))
    time, q, tau = (np.reshape(x, (len(found[0]), -1))[:: read.get("every", 1)] for x in found)
    if read.get("wraps"):
        q = np.unwrap(q, axis=0)
    good = np.abs(q[:, 0]) < read.get("within", np.inf)
    return rising(time[good, 0], q[good], tau[good] * read.get("factor", 1.0))


def from_volts(angle: np.ndarray, volts: np.ndarray) -> list[np.ndarray]:
    """Return time, angle and torque of a motor from its volts, by the maker's constants.

    Efficiencies 0.9 and 0.69, gear 70, 7.68e-3 N m/A and V s/rad, 2.6 ohm; speed from the angle.
    """
    q, step = np.radians(angle[:, 2]), angle[1, 0] - angle[0, 0]
    speed = np.gradient(smooth(q, 20 * step), step)
    return [angle[:, 0], q, 0.9 * 70 * 0.69 * 7.68e-3 / 2.6 * (volts[:, 1] - 70 * 7.68e-3 * speed)]


def smooth(values: np.ndarray, cycles: float) -> np.ndarray:
    """Return values low-passed forward and backward at so many cycles a row."""
    b, a = butter(4, min(2 * cycles, 0.95))
    return filtfilt(b, a, values, axis=0)


def rising(time: np.ndarray, *values: np.ndarray) -> Table:
    """Return rows whose times begin at 0 and rise."""
    later = np.r_[True, time[1:] > np.maximum.accumulate(time)[:-1]]
    q, tau = (x[later] for x in values)
    return time[later] - time[later][0], q, tau


def recordings(case: dict[str, Any], sources: Path) -> Iterator[tuple[str, Table]]:
    """Yield the file names and contents of a case; one recording is cut where a share is stated."""
    source = TABLE["sources"][case["source"]]
    folder = sources / source["repository"].replace("/", "+")
    tables = {
        kind: [recording(source["read"], folder, run) for run in case.get(runs, ())]
        for kind, runs in (("recording", "diagnosed"), ("heldout", "heldout"))
    }
    if "cut" in case:
        whole = tables["recording"][0]
        at = int(case["cut"] * len(whole[0]))
        tables = {
            "recording": [rising(*(x[:at] for x in whole))],
            "heldout": [rising(*(x[at:] for x in whole))],
        }
    for kind, found in tables.items():
        for i, table in enumerate(found, 1):
            yield f"{kind}{f'_{i}' if i > 1 else ''}.parquet", table


# ------------------------------------------------------------------ robots and simulations
def robot(spec: dict[str, Any], folder: Path) -> str:
    """Return a URDF: a chain of links, or a file without shapes, some links left out."""
    if "chain" in spec:
        return chain(spec["chain"])
    path = EXAMPLE_ROBOTS / spec["example"] if "example" in spec else folder / spec["file"]
    root, gone = ET.parse(path).getroot(), spec.get("without", ())  # noqa: S314  # of a known commit
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
        if link.get("name") in gone:
            root.remove(link)
    for joint in root.findall("joint"):
        if any(child.get("link") in gone for child in joint.findall("child")):
            root.remove(joint)
        elif "finger" in str(joint.get("name")):
            joint.set("type", "fixed")
            for part in joint.findall("mimic"):
                joint.remove(part)
    return ET.tostring(root, "unicode")


def chain(links: list[dict[str, Any]]) -> str:
    """Return the URDF of links one behind the other, each turning about y, or about its axis.

    mass [kg], com [m], moment [kg m^2] through com, at [m]: the joint in the frame before it.
    """
    text = ['<robot name="bench"><link name="link0"/>']
    for j, link in enumerate(links, 1):
        at, com = (" ".join(map(str, link.get(k, (0, 0, 0)))) for k in ("at", "com"))
        i = link["moment"]
        text.append(
            f'<joint name="joint{j}" type="revolute"><parent link="link{j - 1}"/>'
            f'<child link="link{j}"/><origin xyz="{at}"/><axis xyz="{link.get("axis", "0 1 0")}"/>'
            '<limit lower="-10000" upper="10000" effort="1000" velocity="1000"/></joint>'
            f'<link name="link{j}"><inertial><origin xyz="{com}"/><mass value="{link["mass"]}"/>'
            f'<inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial></link>'
        )
    return "\n".join([*text, "</robot>"])


def effects(stated: dict[str, list[float]]) -> list[dict[str, Any]]:
    """Return the effects of a simulation whose lists go over the joints."""
    dry = stated.get("tau_c", [])
    widths = stated.get("v_eps", [0.05] * len(dry))
    found = [
        {"effect": "coulomb_friction", "joint": j, "tau_c": value, "v_eps": width}
        for j, (value, width) in enumerate(zip(dry, widths, strict=True), 1)
        if value
    ]
    for key, (effect, parameter) in PARAMETERS.items():
        values = enumerate(stated.get(key, ()), 1)
        found += [{"effect": effect, "joint": j, parameter: value} for j, value in values if value]
    return found


# ------------------------------------------------------------------ writing and comparing
def build(name: str, sources: Path, out: Path) -> None:
    """Write one case, and how well the simulations without and with the truth predict."""
    case, folder = TABLE["cases"][name], out / name
    source = TABLE["sources"][case["source"]]
    fetched = sources / source["repository"].replace("/", "+")
    folder.mkdir(parents=True, exist_ok=True)
    for label, spec, stated in (
        ("robot", case["robot"], case["stated"]),
        ("known", case.get("known_robot", case["robot"]), case.get("known")),
    ):
        (folder / f"{label}.urdf").write_text(robot(spec, fetched))
        content = {"robot": f"{label}.urdf", "tolerances": case["tolerances"]}
        if stated is not None:
            content["effects"] = effects(stated)
            file = folder / {"robot": "sim.yaml", "known": "known.yaml"}[label]
            file.write_text(yaml.safe_dump(content, sort_keys=False))
    files = []
    for file, (time, *values) in recordings(case, sources):
        columns = {"time": time}
        for label, array in zip(("position", "torque"), values, strict=True):
            columns |= {f"{label}_{j}": x for j, x in enumerate(array.T, 1)}
        pq.write_table(pa.table(columns), folder / file)
        files.append(file)
    heldout = [file for file in files if file.startswith("heldout")]
    moving = case.get("moving", 0.0)
    lists = {key: flat(case.get(key, [])) for key in ("accept_also", "tolerated", "must_not")}
    truth = {
        "case": name,
        "kind": "truth" if "effects" in case else "negative",
        "effects": case.get("effects", []),
        **lists,
        "note": f"{source['repository']} {source['commit'][:8]}: {case['why']}",
        "recordings": [file for file in files if file not in heldout],
        "heldout": heldout,
        "score_rows": {"speed_above": moving, "filter_hz": BANDWIDTH} if moving else None,
        "rmse_before": errors(folder, heldout, "sim.yaml", moving),
        "rmse_with_effect": errors(folder, heldout, "known.yaml", moving)
        if "known" in case
        else None,
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))
    print(name, truth["rmse_before"], truth["rmse_with_effect"], flush=True)


def flat(names: list[Any]) -> list[str]:
    """Return names of which some are lists of names."""
    return [x for name in names for x in (name if isinstance(name, list) else [name])]


def errors(folder: Path, files: list[str], simulation: str, moving: float) -> list[float]:
    """Return the RMSE [N m] by joint of `limo predict` over the rows that are scored, (n,)."""
    wrong = []
    for file in files:
        out = folder / f"predicted_by_{Path(simulation).stem}.parquet"
        command = ["predict", folder / file, "--sim", folder / simulation, "--out", out]
        run = "from limo_driver.app.cli import main; main()"
        subprocess.run([sys.executable, "-c", run, *map(str, command)], check=True)
        recorded, predicted = pq.read_table(folder / file), pq.read_table(out)
        labels = [f"_{j}" for j in range(1, predicted.num_columns)]
        q, tau, model = (
            np.column_stack([table[f"{kind}{j}"].to_numpy() for j in labels])
            for table, kind in ((recorded, "position"), (recorded, "torque"), (predicted, "torque"))
        )
        step = float(np.median(np.diff(recorded["time"].to_numpy())))
        fast = np.abs(np.gradient(smooth(q, BANDWIDTH * step), step, axis=0)) > moving
        wrong.append(np.where(fast | (moving == 0), tau - model, np.nan))
    return [float(x) for x in np.sqrt(np.nanmean(np.concatenate(wrong) ** 2, axis=0))]


def values(cases: Path, out: Path) -> None:
    """Print every value told of an effect whose range is known, and whether it lies there."""
    for name in TABLE["cases"]:
        if not (out / name / "verdict.json").exists():
            print(name, "was not diagnosed")
            continue
        verdict = json.loads((out / name / "verdict.json").read_text())
        told = [*verdict["findings"], *verdict.get("identified", [])]
        for want in json.loads((cases / name / "truth.json").read_text())["effects"]:
            for item in (item for item in told if item["effect"] == want["effect"]):
                for key, (low, high) in want["params"].items():
                    value = np.ravel(item["parameters"].get(key, {}).get("value", np.nan))
                    inside = "inside" if np.all((low <= value) & (value <= high)) else "OUTSIDE"
                    joints = item.get("joints", [item.get("joint")])
                    print(name, want["effect"], joints, key, value, inside, [low, high])


def files() -> None:
    """Print the repositories, their commits and licences, and the files that are read."""
    for key, source in TABLE["sources"].items():
        print(f"{source['repository']}@{source['commit']} ({source['licence']})")
        cases = [case for case in TABLE["cases"].values() if case["source"] == key]
        runs = [run for case in cases for run in (*case["diagnosed"], *case.get("heldout", ()))]
        described = [case["robot"]["file"] for case in cases if "file" in case["robot"]]
        wanted = [*described, *(path for run in runs for path in paths(source["read"], run))]
        print(*(f"  {path}" for path in dict.fromkeys(wanted)), sep="\n")


def main() -> None:
    """Print what to fetch, build the cases, or print values beside what is known."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("action", choices=("files", "build", "values"))
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--only", nargs="*", default=list(TABLE["cases"]), help="names of cases")
    options = parser.parse_args()
    if options.action == "files":
        files()
    elif options.action == "values":
        values(*options.folders)
    else:
        for name in options.only:
            build(name, *options.folders)


if __name__ == "__main__":
    main()
