"""The command line in this process."""

from typer.testing import CliRunner

from meshtrace import cli


def meshtrace(*arguments):
    return CliRunner().invoke(
        cli.app, [str(word) for word in arguments], env={"COLUMNS": "100", "NO_COLOR": "1"}
    )


def refusal(*arguments):
    """Return the only line of a refused command."""
    refused = meshtrace(*arguments)
    assert (refused.exit_code, refused.stdout) == (2, ""), arguments
    assert refused.stderr.startswith("error: ")
    assert refused.stderr.count("\n") == 1
    return refused.stderr.removeprefix("error: ").rstrip("\n")
