"""Bulletins of a service before it serves: what compiles while it loads is told as compiling."""

import json

from limo_driver.app.cli.serve import teller
from limo_driver.app.library.serving import COMPILING, Bulletins
from limo_driver.network.readiness import ServicePhase
from limo_driver.runtime import compilation
from limo_driver.runtime.compilation import Compilation


def test_a_service_that_compiles_while_it_loads_is_compiling_from_then_on(capsys, monkeypatch):
    monkeypatch.setattr(compilation, "_last", None)  # of this process, put back at the end
    bulletins = Bulletins(["iiwa14"], teller(several=False, as_json=True))
    told = bulletins.of["iiwa14"]
    bulletins.enter(ServicePhase.LOADING, "loading models and physics")
    with compilation.told(bulletins.tell_compiled):
        assert told.phase is ServicePhase.LOADING
        compilation.tell(Compilation("f", running=True, done=0, most=2, seconds=0.0))
        assert told.phase is ServicePhase.COMPILING
        assert told.state == "compiling, 0 of at most 2 functions done"
        compilation.tell(Compilation("f", running=False, done=1, most=2, seconds=0.1))
        bulletins.enter(ServicePhase.COMPILING, COMPILING)
        assert told.phase is ServicePhase.COMPILING
    events = [json.loads(line)["event"] for line in capsys.readouterr().out.splitlines()]
    assert events == ["loading", "compiling"]
