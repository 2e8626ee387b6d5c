"""The folder of tables and kernels that are computed once for a user."""

import os
from pathlib import Path

import platformdirs
import pytest

from meshtrace import files


def no_home(*args, **kwargs):
    raise RuntimeError("no home")


def test_a_setting_takes_precedence(monkeypatch, tmp_path):
    monkeypatch.setenv("MESHTRACE_CACHE_DIR", "here")
    monkeypatch.chdir(tmp_path)
    assert files.cache_directory() == tmp_path / "here"


def test_the_default_is_the_cache_folder_of_the_user(monkeypatch):
    monkeypatch.delenv("MESHTRACE_CACHE_DIR", raising=False)
    assert files.cache_directory() == Path(
        platformdirs.user_cache_dir("meshtrace", appauthor=False)
    )


@pytest.mark.parametrize("found", [lambda *args, **kwargs: "~/.cache/meshtrace", no_home])
def test_a_user_without_a_home_gets_a_folder_that_cannot_be_written(monkeypatch, found):
    monkeypatch.delenv("MESHTRACE_CACHE_DIR", raising=False)
    monkeypatch.setattr("platformdirs.user_cache_dir", found)
    assert files.cache_directory().parts[:-1] == Path(os.devnull).parts
    with pytest.raises(OSError, match="Not a directory"):
        files.cache_directory().mkdir(parents=True)
