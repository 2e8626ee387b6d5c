"""Output files are replaced whole or not at all."""

import os
import signal
import stat
import subprocess
import sys
import time

import pytest

from meshtrace import errors
from meshtrace.errors import Refused
from meshtrace.files import atomic

SLOW_WRITER = """
import sys, time
from meshtrace.files import atomic
print("ready", flush=True)
with atomic(sys.argv[1]) as temporary:
    with temporary.open("wb") as file:
        for _ in range(400):
            file.write(b"n" * 4096)
            file.flush()
            time.sleep(0.0005)
"""


def test_a_block_that_fails_leaves_the_old_file_and_no_other(tmp_path):
    target = tmp_path / "a.nc"
    target.write_bytes(b"old")

    def fail():
        with atomic(target) as temporary:
            temporary.write_bytes(b"half of the n")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert target.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.nc"]


def test_the_temporary_file_is_on_the_same_disk_with_the_suffix_of_the_target(tmp_path):
    with atomic(tmp_path / "a.png") as temporary:
        assert temporary.parent == tmp_path.resolve()
        assert temporary.suffix == ".png"


@pytest.mark.posix
def test_a_new_file_follows_the_umask_and_an_old_one_keeps_its_permissions(tmp_path):
    old = os.umask(0o027)
    try:
        with atomic(tmp_path / "new") as temporary:
            temporary.write_bytes(b"1")
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o640
    (tmp_path / "new").chmod(0o604)
    with atomic(tmp_path / "new") as temporary:
        temporary.unlink()  # a writer may put a file of its own in place
        temporary.write_bytes(b"2")
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o604
    assert (tmp_path / "new").read_bytes() == b"2"


@pytest.mark.posix
def test_a_symbolic_link_stays_and_its_target_is_replaced(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "real").write_bytes(b"old")
    (tmp_path / "link").symlink_to(tmp_path / "folder" / "real")
    with atomic(tmp_path / "link") as temporary:
        temporary.write_bytes(b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "folder" / "real").read_bytes() == b"new"


def test_an_error_of_the_disk_names_the_target(tmp_path):
    with pytest.raises(OSError, match=r"a\.nc"), atomic(tmp_path / "a.nc"):
        raise OSError(28, "No space left on device", "somewhere else")
    assert list(tmp_path.iterdir()) == []


def test_a_killed_writer_leaves_the_old_file_whole(tmp_path):
    target = tmp_path / "a.bin"
    target.write_bytes(b"o" * 100)
    for delay in (0.02, 0.1, 0.2):
        process = subprocess.Popen(
            [sys.executable, "-c", SLOW_WRITER, str(target)], stdout=subprocess.PIPE
        )
        assert process.stdout.readline() == b"ready\n"
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        assert target.read_bytes() in (b"o" * 100, b"n" * 4096 * 400)


@pytest.mark.posix
def test_a_new_or_regular_file_may_be_written(tmp_path):
    (tmp_path / "old").write_bytes(b"")
    errors.require_writable(tmp_path / "old", inputs=[None, tmp_path / "none", tmp_path])
    errors.require_writable(tmp_path / "new")
    (tmp_path / "dangling").symlink_to(tmp_path / "new")
    errors.require_writable(tmp_path / "dangling")


def _unwritable(folder):
    (folder / "file").write_bytes(b"")
    (folder / "sealed").write_bytes(b"")
    (folder / "sealed").chmod(0o444)
    (folder / "loop").symlink_to(folder / "loop")
    os.mkfifo(folder / "fifo")
    return {
        "folder": folder,
        "device": "/dev/null",
        "fifo": folder / "fifo",
        "read-only": folder / "sealed",
        "long": folder / ("x" * 300),
        "no folder": folder / "none" / "a.nc",
        "file as folder": folder / "file" / "a.nc",
        "loop": folder / "loop",
        "zero": f"{folder}/a\0b",
    }


@pytest.mark.posix
def test_what_cannot_be_written_is_refused_in_one_line(tmp_path):
    for case, path in _unwritable(tmp_path).items():
        with pytest.raises(Refused) as caught:
            errors.require_writable(path, field="-o")
        assert str(caught.value).startswith("-o: "), case
        assert "allowed: a file in an existing folder" in str(caught.value), case
        assert "\n" not in str(caught.value), case


def test_another_output_is_refused_before_it_exists(tmp_path):
    with pytest.raises(Refused, match="other outputs"):
        errors.require_writable(tmp_path / "a.nc", inputs=[tmp_path / "none" / ".." / "a.nc"])


@pytest.mark.parametrize("make", [os.link, pytest.param(os.symlink, marks=pytest.mark.posix)])
def test_the_input_is_refused_under_any_name(tmp_path, make):
    (tmp_path / "link.toml").write_bytes(b"")
    make(tmp_path / "link.toml", tmp_path / "other")
    with pytest.raises(Refused, match="other than the input"):
        errors.require_writable(tmp_path / "other", inputs=[tmp_path / "link.toml"])


def test_the_next_process_removes_what_a_killed_one_left(tmp_path):
    target = tmp_path / "a.bin"
    write = [sys.executable, "-c", SLOW_WRITER, str(target)]
    process = subprocess.Popen(write, stdout=subprocess.PIPE)
    process.stdout.readline()
    while not any(tmp_path.iterdir()):
        time.sleep(0.01)
    live = next(tmp_path.iterdir())
    foreign = tmp_path / ".meshtrace-elsewhere-1-0.bin"
    foreign.touch()
    code = "import sys; from meshtrace.files import atomic; atomic(sys.argv[1]).__enter__()"
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "b")], check=True)
    assert live.exists()  # its writer still runs
    process.kill()
    process.wait()
    process.stdout.close()
    subprocess.run(write, stdout=subprocess.PIPE, check=True)
    assert sorted(tmp_path.iterdir()) == [foreign, target]
