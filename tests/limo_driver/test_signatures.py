"""Every type that a public signature names can be had from a public module, and examples run."""

import ast
import builtins
import inspect
import re
import symtable
import textwrap
import typing
from collections import abc
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.physics import CoulombFriction, PositionServo

PUBLIC = (
    "limo_driver",
    "limo_driver.types",
    "limo_driver.model",
    "limo_driver.trajectory",
    "limo_driver.robot.robot",
    "limo_driver.recordings.recording",
    "limo_driver.logs.readers",
    "limo_driver.exports",
    "limo_driver.network.messages",
    "limo_driver.physics",
    "limopa",
    "estimators",
    "estimators.rigid_body",
    "estimators.hybrid",
    "estimators.diagnosis",
    "estimators.diagnosis.from_motion",
    "estimators.studies",
    "estimators.service",
    "limo_driver.app.library.simulating",
)
EVERYWHERE = (builtins, typing, abc, np, {"Path": Path, "NDArray": 1, "ArrayLike": 1, "np": np})
# What runs for longer than a moment, needs the network, or a model that was trained before.
LONG = (
    "contact_thresholds",
    "diagnose",
    "diagnose_fleet",
    "simulate_dataset",
    "sweep",
    "identify",
    "nominal",
    "train",
    "plan",
    "excite",
    "excite_servos",
    "serve",
    "evaluate",
    "export_onnx",
    "export_ros2",
    "load_model",
)


def named(annotation):
    """Names in an annotation, those in strings inside of it as well."""
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    return {node.id for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)}


def annotations(name):
    """Annotations of a function, or of a class: its fields, its methods and its properties."""
    member = getattr(limo, name)
    functions = [member] if inspect.isfunction(member) else []
    if inspect.isclass(member):
        found = [value for key, value in inspect.getmembers_static(member) if key[0] != "_"]
        functions = [
            member.__init__,
            *(getattr(f, "__func__", getattr(f, "fget", f)) for f in found),
        ]
        if is_dataclass(member):
            yield from (item.type for item in fields(member) if item.init)
    for function in functions:
        if inspect.isfunction(function) and function.__module__.split(".")[0] in OWN:
            signature = inspect.signature(function)
            given = [*(p.annotation for p in signature.parameters.values())]
            yield from (a for a in (*given, signature.return_annotation) if a is not inspect._empty)


OWN = {"limo_driver", "limopa", "estimators", "backends"}


def is_general(name):
    return any(name in x if isinstance(x, dict) else hasattr(x, name) for x in EVERYWHERE)


def is_public(name):
    for module in map(import_module, PUBLIC):
        if name in getattr(module, "__all__", ()) or (
            not hasattr(module, "__all__") and hasattr(module, name)
        ):
            return getattr(module, name) is not None
    return False


@pytest.mark.parametrize("name", limo.__all__)
def test_every_type_in_a_signature_can_be_had_from_a_public_module(name):
    wanted = set().union(*map(named, annotations(name)))
    assert {x for x in wanted if not is_general(x) and not is_public(x)} == set()


def examples():
    """Code of each example in the help of what is exported, by a name of its own."""
    for name in limo.__all__:
        member = getattr(limo, name)
        texts = {name: inspect.getdoc(member)}
        if inspect.isclass(member):
            own = {key: inspect.getdoc(f) for key, f in vars(member).items() if key[0] != "_"}
            texts |= {f"{name}.{key}": text for key, text in own.items()}
        for called, text in texts.items():
            lines = re.findall(r"^ *(?:>>>|\.\.\.) ?(.*)$", text or "", re.MULTILINE)
            if lines:
                yield pytest.param("\n".join(lines) + "\n", id=called)


def free_names(table):
    """Names that code uses and does not define."""
    own = {s.get_name() for s in table.get_symbols() if s.is_referenced() and not s.is_assigned()}
    own -= {s.get_name() for s in table.get_symbols() if s.is_imported()}
    return own.union(*map(free_names, table.get_children()))


EXAMPLES = list(examples())


@pytest.mark.parametrize("code", EXAMPLES)
def test_an_example_needs_nothing_but_two_imports(code):
    assert free_names(symtable.symtable(code, "example", "exec")) - set(dir(builtins)) <= {
        "limo",
        "np",
    }
    used = re.findall(r"\blimo\.([A-Za-z_0-9]+)", code)
    assert [name for name in used if name not in limo.__all__ and name != "traj"] == []


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files that examples read."""
    folder = tmp_path_factory.mktemp("examples")
    sim = limo.Simulation("iiwa14", (CoulombFriction(joint=1, tau_c=0.5),))
    sim.save(folder / "sim.yaml")
    t = np.arange(0, 4, 0.004)
    motion = limo.Motion.from_positions(t, 0.2 * (1 - np.cos(np.pi * t / 2))[:, None] * np.ones(7))
    torque = sim.predict(motion)
    for name in ("run.parquet", "scan.parquet"):
        limo.Recording.from_arrays(t, motion.position, torque).save(folder / name)
    servos = tuple(PositionServo(joint=joint, kp=2000.0, kd=100.0) for joint in range(1, 8))
    limo.Simulation("iiwa14", drives=servos).save(folder / "servos.yaml")
    commanded = limo.Recording.from_arrays(t, motion.position, command=motion.position)
    commanded.save(folder / "commanded.parquet")
    rest = np.zeros_like(motion.position)
    trajectory = limo.Trajectory(t, motion.position, rest, rest, robot="iiwa14")
    trajectory.first(0.5).save(folder / "limo.traj.parquet")
    return folder


@pytest.mark.parametrize(
    "code", [x for x in EXAMPLES if not any(f"limo.{y}(" in x.values[0] for y in LONG)]
)
def test_an_example_runs(code, folder, monkeypatch):
    monkeypatch.chdir(folder)
    if "Streaming" in code:
        pytest.skip("is on the network")
    exec(textwrap.dedent(code), {"limo": limo, "np": np})  # noqa: S102  # our own
