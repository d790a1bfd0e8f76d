"""The page of a step to a first motion: verdict, figures, what only people can check, signature."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.app.library.first_motion.records import PASSED, STEPS, TITLES, Folder, number_of
from limo_driver.errors import LimoError
from limo_driver.pages import Charts, Page, markup
from limo_driver.pages.figures import DRAWN, JOINTS, MEASURED, curve, joint_motion, layout, numbers
from limo_driver.quoting import in_html as escape
from limo_driver.recordings.recording import Recording
from limo_driver.trajectory import Trajectory

if TYPE_CHECKING:
    from limo_driver.app.library.first_motion.arms import RealArm

Record = dict[str, Any]

_BADGES: Final = {True: ("passed", "consistent"), False: ("failed", "unexplained")}
_ASKED: Final = {  # of people, before they sign
    "link": (
        "The arm's own safety functions are configured for the task, and were tested today.",
        "An emergency stop that cuts power without this computer is in reach.",
        "The network or bus is the arm's own: nobody else sends there.",
        "Version, serial numbers and send period are those of this arm's papers.",
    ),
    "receive": (
        "The tool that is mounted is the one described; it is fixed, and its cables are free.",
        "Turn each joint by hand, one at a time: the reading of that joint changes, and its sign "
        "is that of the description. Gravity does not show the mistakes listed above as unseen.",
        "A turn of the base about the vertical shows in no torque: compare with the drawing.",
        "Ranges of the description are those of the arm's mechanical stops, or within them.",
    ),
    "shadow": (
        "Look at both motions above: nothing stands where the arm will go.",
        "Table, walls and the tool are stated, or farther away than the motion comes.",
        "The arm still stands where the motions begin.",
    ),
    "one-joint": (
        "The joint that moved was the one named, in the direction of the description.",
        "Nothing knocked, sagged or hummed when the arm was taken over and let go.",
        "The emergency stop was pressed once during a repetition, and stopped the arm.",
    ),
    "limopa": (
        "Nobody stood within reach, and a hand was on the stop.",
        "The arm kept clear of everything by as much as was planned.",
        "Temperatures and noises of the joints are as before.",
    ),
}
_SIGNED: Final = "Who signs has looked at this page, at the arm, and at what is listed above."
_TORQUES: Final = (
    "Torque that gravity leaves, over the tolerance of the joint: between the lines at -1 and 1 it "
    "is gravity."
)


def step_page(record: Record, arm: RealArm, folder: Folder) -> Page:
    """Return the page of a step.

    Args:
        record: As it was written.
        arm: Whose it is.
        folder: Where its files are.
    """
    step, charts = record["step"], Charts()
    number, passed = number_of(step), record["verdict"] == PASSED
    problems = [each["text"] for each in record["findings"] if each["problem"]]
    notes = [each["text"] for each in record["findings"] if not each["problem"]]
    title = problems[0] if problems else (notes[-1] if notes else f"{TITLES[step]}: passed")
    about = (
        f"{record['robot']}, {record['address'] or 'no address yet'}, {record['ended']}, limo "
        f"{record['limo']}."
    )
    figures = {
        "link": _link,
        "receive": _receive,
        "shadow": _shadow,
        "one-joint": _motion,
        "limopa": _motion,
    }[step](record, arm, folder, charts)
    crumb = f"First motion of {record['robot']}, step {number} of {len(STEPS)}: {TITLES[step]}"
    body = (
        markup.header(crumb, f"{title[:1].upper()}{title[1:]}.", about, badge=_BADGES[passed])
        + markup.section("What was found", _findings(record), "findings")
        + figures
        + markup.section("What only people can check", markup.listed(_ASKED[step]), "people")
        + markup.section("Signature", _signature(record, folder), "signature", _SIGNED)
        + markup.next_steps(_next(record, arm, folder))
    )
    return Page(f"{crumb}: {_BADGES[passed][0]}", body, charts)


def _findings(record: Record) -> str:
    rows = [
        [
            f'<b class="failed">{escape(each["code"])}</b>' if each["problem"] else each["code"],
            escape(each["text"]),
        ]
        for each in sorted(record["findings"], key=lambda each: not each["problem"])
    ]
    return markup.table(["kind", "what"], rows) if rows else "<p>Nothing that has to be known.</p>"


def _signature(record: Record, folder: Folder) -> str:
    lines = markup.table(
        ["name", "function", "date", "signature"], [["<br><br>"] * 4, ["<br><br>"] * 4]
    )
    seal = folder.seal(record["step"])
    known = {
        "record": f"{folder.file(record['step'], '.json').name}, SHA-256 {seal}",
        "description": f"{record['robot']}, SHA-256 {record['description']}",
        "follows": record["follows"] or "nothing: this is the first step",
    }
    return lines + markup.key(known)


def _next(record: Record, arm: RealArm, folder: Folder) -> list[tuple[str, str]]:
    from limo_driver.quoting import in_shell

    step, out = record["step"], f"--out {in_shell(folder.path)}"
    if record["verdict"] != PASSED:
        return [
            (
                "Cure what failed, then repeat this step. The next one is refused until then.",
                f"{arm.command} {out} --step {step}",
            )
        ]
    if step == STEPS[-1]:
        return []
    after = STEPS[number_of(step)]
    return [
        (f"Then, once this page is signed: {TITLES[after]}.", f"{arm.command} {out} --step {after}")
    ]


def _link(record: Record, _arm: RealArm, _folder: Folder, _charts: Charts) -> str:
    figures = record["figures"]
    rows = {name: value for name, value in figures.items() if isinstance(value, (int, float, str))}
    rows |= _counts(figures.get("link", {}))
    body = (
        markup.columns({"what": list(rows), "value": list(map(_shown, rows.values()))})
        if rows
        else ""
    )
    if drives := figures.get("drives"):
        names = list(dict.fromkeys(name for each in drives for name in each))
        body += markup.columns(
            {"joint": range(1, len(drives) + 1)}
            | {name: [_hex(each.get(name)) for each in drives] for name in names}
        )
    return markup.section("Figures of the link", body, "figures")


def _receive(record: Record, arm: RealArm, _folder: Folder, charts: Charts) -> str:
    figures, limits = record["figures"], arm.model.limits
    counts = {
        "measurements": figures.get("cycles"),
        "lost": figures.get("lost"),
        "more than 10 ms late": figures.get("late"),
        "interruptions": len(figures.get("interruptions", ())),
        **{
            f"jitter {name.replace('_', '.')}": _ms(figures, name)
            for name in ("p50", "p99", "p99_9", "longest")
        },
    }
    link = markup.columns({"what": list(counts), "value": list(map(_shown, counts.values()))})
    link += markup.folded("All counts of the link", _table_of(_counts(figures.get("link", {}))))
    degrees = {
        "joint": list(range(1, arm.model.n + 1)),
        "lowest [°]": _degrees(figures.get("lowest")),
        "highest [°]": _degrees(figures.get("highest")),
        "range from [°]": _degrees(limits.position_min.tolist()),
        "to [°]": _degrees(limits.position_max.tolist()),
    }
    body = markup.section("Figures of the link", link, "link")
    if figures.get("lowest"):
        body += markup.section("Positions and ranges", markup.columns(degrees), "ranges")
    if figures.get("poses"):
        drawn = charts.place(_rests(figures), "Torque that gravity leaves, over its tolerance")
        unseen = markup.paragraph("; ".join(figures["unseen"]) + ".") if figures["unseen"] else ""
        body += markup.section("Torques at rest", drawn + _poses(figures), "gravity", _TORQUES)
        body += markup.section("What these poses could not show", unseen, "unseen")
    return body


def _rests(figures: Record) -> markup.Figure:
    """Return a chart of what gravity leaves of the torques of each pose."""
    torques, gravity = np.array(figures["torques"]), np.array(figures["gravity"])
    share = (torques - gravity) / np.array(figures["tolerance"])
    joints = [f"joint {j + 1}" for j in range(share.shape[1])]
    data = [
        {
            "type": "bar",
            "x": joints,
            "y": numbers(row),
            "name": f"pose {k + 1}",
            "marker": {"color": JOINTS[k % len(JOINTS)]},
        }
        for k, row in enumerate(share)
    ]
    line = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "line": {"color": MEASURED}}
    axes = layout("", "torque at rest, in tolerances")
    axes["shapes"] = [line | {"y0": y, "y1": y} for y in (-1, 1)]
    return {"data": data, "layout": axes | {"showlegend": True}}


def _poses(figures: Record) -> str:
    rows: dict[str, list[object]] = {"pose": [], "": []}
    n = len(figures["tolerance"])
    rows |= {f"joint {j + 1}": [] for j in range(n)}
    for k, pose in enumerate(figures["poses"]):
        for name, values in (
            ("position [°]", np.degrees(pose).tolist()),
            ("torque [N m]", figures["torques"][k]),
            ("gravity [N m]", figures["gravity"][k]),
        ):
            rows["pose"].append(k + 1)
            rows[""].append(name)
            for j, value in enumerate(values):
                rows[f"joint {j + 1}"].append(f"{value:.1f}")
    return markup.columns(rows, numeric=2)


def _shadow(record: Record, _arm: RealArm, folder: Folder, charts: Charts) -> str:
    body = ""
    for name, motion in record["figures"].get("motions", {}).items():
        path = folder.path / motion["file"]
        drawn = _drawn(charts, path, f"{TITLES[name]}: the motion that was computed")
        facts = {
            "duration [s]": motion["duration"],
            "cycles": motion["samples"],
            "limits met": "none" if not motion["limited"] else None,
            **{f"limited by {x.replace('_', ' ')}": n for x, n in motion["limited"].items()},
            "file": motion["file"],
            "SHA-256": motion["digest"],
        }
        known = {what: value for what, value in facts.items() if value is not None}
        body += markup.section(TITLES[name], drawn + _table_of(known), name)
    return body


def _drawn(charts: Charts, path: Any, caption: str) -> str:  # noqa: ANN401  # a path
    try:
        motion = Trajectory.load(path)
    except LimoError:  # a motion that is not there is not drawn
        return ""
    return charts.place(joint_motion(motion, ("",) * motion.n), caption)


def _motion(record: Record, arm: RealArm, folder: Folder, charts: Charts) -> str:
    figures, step = record["figures"], record["step"]
    path = folder.file(step, ".parquet")
    drawn = ""
    if "samples" in figures:
        try:
            drawn = charts.place(_followed(Recording.load(path)), "Measured minus commanded")
        except LimoError:  # a recording that cannot be read is not drawn
            drawn = ""
    if "travel" in figures:
        low, high = figures["travel"]
        values: dict[str, list[Any]] = {
            "joint": list(range(1, arm.model.n + 1)),
            "lowest from the start [°]": _degrees(low),
            "highest [°]": _degrees(high),
            "torque other than gravity, at most [N m]": [f"{x:.2f}" for x in figures["torque"]],
        }
        if "tracking_max" in figures:
            values["off its set-point, at most [mrad]"] = [
                f"{1e3 * x:.2f}" for x in figures["tracking_max"]
            ]
        drawn += markup.columns(values)
    counts = _table_of(_counts(figures.get("link", {})))
    return markup.section("The motion", drawn, "motion") + markup.section(
        "Figures of the link", counts, "figures"
    )


def _followed(recording: Recording) -> markup.Figure:
    step = max(1, len(recording.time) // DRAWN)
    commanded = recording.command
    axes = layout("time [s]", "measured minus commanded [mrad]")
    data = (
        [
            curve(
                recording.time[::step],
                1e3 * (recording.position - commanded)[::step, j],
                f"joint {j + 1}",
                JOINTS[j % len(JOINTS)],
            )
            for j in range(recording.n)
        ]
        if commanded is not None
        else []
    )
    return {"data": data, "layout": axes | {"showlegend": True}}


def _counts(link: Record) -> Record:
    return {
        name.replace("_", " "): value
        for name, value in link.items()
        if isinstance(value, (int, float, str)) and value != ""
    }


def _table_of(values: Record) -> str:
    if not values:
        return ""
    return markup.columns({"what": list(values), "value": list(map(_shown, values.values()))})


def _shown(value: object) -> object:
    return f"{value:.4g}" if isinstance(value, float) else value


def _ms(figures: Record, name: str) -> str | None:
    value = figures.get("jitter", {}).get(name)
    return None if value is None else f"{1e3 * value:.2f} ms"


def _hex(value: int | None) -> str | None:
    return None if value is None else f"{value:#x}"


def _degrees(values: list[float | None] | None) -> list[str | None]:
    return [None if v is None else f"{np.degrees(v):.1f}" for v in values or []]
