"""Change two values of a link file, save the result, and restore the configuration from it."""

import tempfile
from pathlib import Path

import meshtrace as mt
from meshtrace.scenario import Scenario

changes = {"transmitter.depth": 5.0, "run.rtol": 0.001}
scenario = Scenario.load(Path(__file__).with_name("default_link.toml"), changes)
result = scenario.simulate()
print(f"gain {result.gain:.2e} +- {result.gain_stderr:.1e}")

with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "result.nc"
    result.save(file)
    loaded = mt.GainResult.load(file)
again = Scenario.from_provenance(loaded.provenance).simulate()
print("same gain again:", again.gain == result.gain)
