"""Light guided and refracted by a plunging crest, by the example of that name."""

import runpy
from pathlib import Path


def main(folder: Path) -> None:
    example = Path(__file__).parents[2] / "examples" / "plunging_crest.py"
    runpy.run_path(str(example))["main"](folder)


if __name__ == "__main__":
    main(Path(__file__).parent)
