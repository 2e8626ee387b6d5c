"""Compilation of a share of the kernels in a second process, during a first run.

numba compiles one function at a time in a process. Both processes save what they compile, and find
what the other has saved.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from meshtrace.engine.chains.aimed import compile_evaluation
from meshtrace.models import import_modules, modules_of
from meshtrace.parallel import default_threads
from meshtrace.scenario import Scenario


@contextmanager
def compiling_ahead(scenario: Scenario) -> Iterator[None]:
    """Compile the kernels that evaluate chains in a second process while the block draws them.

    Where that process cannot start, fails or is late, the block compiles all of them.
    """
    process = None
    if scenario.run.estimator.kind == "forced" and default_threads() > 1:
        silent = subprocess.DEVNULL
        with suppress(OSError):
            text = scenario.to_toml()
            process = subprocess.Popen(
                [sys.executable, "-m", "meshtrace.cli.ahead", text, *modules_of(text)],
                stdin=silent,
                stdout=silent,
                stderr=silent,
                start_new_session=True,  # Ctrl-C is for the first process, which ends this one
            )
    try:
        yield
    finally:
        if process is not None:
            process.kill()
            process.wait()


def main(toml: str, *modules: str) -> None:
    """Compile for a link file, whose parts may be classes of some modules."""
    import_modules(modules)
    scenario = Scenario.from_toml(toml)
    compile_evaluation(scenario.case().link, scenario.mesh(), scenario.meshing.normals)


if __name__ == "__main__":
    main(*sys.argv[1:])
