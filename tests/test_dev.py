"""./dev says what it needs: wrong commands, and packages that are missing where nobody may install them."""
import os
import pathlib
import shutil
import subprocess
import tempfile

import pytest

import evaluate

NOBODY = 65534


@pytest.mark.parametrize("arguments", [[], ["frobnicate"], ["test", "--fast"], ["bench", "--slow"], ["demo", "now"], ["fabrics", "denim"], ["test", "-k"], ["fuzz", "soon"]])
def test_wrong_use_is_refused(arguments):
    done = subprocess.run([evaluate.ROOT / "dev", *arguments], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("dev: ") and "usage: ./dev" in done.stderr


def test_unknown_suite_is_refused():
    done = subprocess.run([evaluate.ROOT / "dev", "bench", "no-such-suite"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "no-such-suite" in done.stderr and "error-time" in done.stderr


def test_unknown_reader_is_refused():
    done = subprocess.run([evaluate.ROOT / "dev", "fuzz", "1", "no-such-reader"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "no-such-reader" in done.stderr and "wif" in done.stderr


def test_help_names_every_command():
    done = subprocess.run([evaluate.ROOT / "dev", "--help"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert all(f"./dev {command}" in done.stdout for command in ("demo", "app", "test", "bench", "fuzz", "fabrics", "format", "check"))


@pytest.mark.parametrize("command", ["demo", "test", "bench", "check"])
def test_without_root_the_one_apt_command_is_named(command):
    """A dpkg that has nothing, and a user who may do nothing: one line, which is the command; exit 1; nothing made."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        shutil.copy(evaluate.ROOT / "dev", folder)
        (folder / "bin").mkdir()
        for name, text in (("dpkg-query", "exit 1"), ("apt-get", "echo touched >/dev/stderr; exit 1")):
            (folder / "bin" / name).write_text(f"#!/bin/sh\n{text}\n")
            (folder / "bin" / name).chmod(0o755)
        (folder / "tests" / "bench").mkdir(parents=True)
        (folder / "tests" / "bench" / "error_time.py").write_text("")
        folder.chmod(0o755)
        other = {"user": NOBODY} if os.geteuid() == 0 else {}
        environment = {"PATH": f"{folder / 'bin'}:/usr/bin:/bin", "HOME": str(folder)}
        done = subprocess.run(["bash", folder / "dev", command], capture_output=True, text=True, cwd=folder, env=environment, timeout=60, **other)
        assert done.returncode == 1, done.stderr
        said = done.stderr.splitlines()
        assert len(said) == 1 and "apt-get install -y" in said[0] and "touched" not in said[0], done.stderr
        assert not (folder / "build").exists() and not (folder / "out").exists()
