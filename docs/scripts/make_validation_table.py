"""Run all checks of `meshtrace validate` and write them into validation_table.md."""

from __future__ import annotations

from importlib.metadata import version

from places import GENERATED

from meshtrace.validation import Check, validate

PAGE = GENERATED / "validation_table.md"


def row(check: Check) -> str:
    """Return one line of the table."""
    stderr = f"{check.stderr:.1e}" if check.stderr else "-"
    tolerance = f"{check.tolerance:.1e}" if check.tolerance else "-"
    cells = (
        check.quantity.replace("|", "/"),
        check.source,
        f"{check.expected:.6g}",
        f"{check.got:.6g}",
        stderr,
        tolerance,
        f"{check.z:+.2f}",
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Write the table."""
    checks = validate(progress=print)
    worst = max(abs(check.z) for check in checks)
    lines = [
        "<!-- table -->",
        f"Measured with version {version('meshtrace')} by `docs/scripts/make_validation_table.py`: "
        f"{len(checks)} checks, the largest |z| is {worst:.2f}.",
        "",
        "| quantity | source | expected | got | standard error | tolerance | z |",
        "|---|---|---|---|---|---|---|",
        *map(row, checks),
        "<!-- end -->",
    ]
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
