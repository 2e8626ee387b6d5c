import pytest


@pytest.fixture(autouse=True)
def compiled(monkeypatch):
    """Leave out the note about compiling, which depends on the tests that ran before."""
    monkeypatch.setattr("meshtrace.kernels.jit.is_compiled", lambda kernel: True)
