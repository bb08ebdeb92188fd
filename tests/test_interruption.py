"""Whatever ends a render, and whenever: no file is half written, and --resume ends with the bits of a run that nothing ended.

Seen red with files that are written under their own name."""
import json
import os
import pathlib
import random
import resource
import shutil
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import OpenEXR
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
RENDER = pathlib.Path(os.environ.get("SELVEDGE_BIN", ROOT / "build" / "bin")) / "selvedge-render"
SCENE = {"film": {"resolution": [8, 8]}, "camera": {"position": [0, 1, 3], "target": [0, 0, 0]},
         "lights": [{"type": "environment", "colour": [1, 2, 3]}, {"type": "point", "position": [1, 2, 1], "intensity": 4}],
         "objects": [{"shape": "plane", "scale": 3, "rotate": [20, 0, 0]},
                     {"shape": "plane", "translate": [0, 0.3, 0], "fabric": {"name": "open", "pattern": "plain 1/1", "resolution": 64,
                      "warp": {"spacing": 0.0004, "width": 0.0002}, "weft": {"spacing": 0.0004, "width": 0.0002}}}]}
SAMPLES = 16384
INTERRUPTIONS = 100


@pytest.fixture(autouse=True)
def signals_end_programs():
    """A shell starts its background jobs with SIGINT ignored, and programs inherit that; a handler of ours becomes theirs by default."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def write_scene(folder):
    folder.mkdir(exist_ok=True)
    (folder / "scene.json").write_text(json.dumps(SCENE))
    return folder


def command(folder, *options):
    return [str(RENDER), str(folder / "scene.json"), "-o", str(folder / "out.exr"), "-q", "--integrator", "path", "--threads", "1", *map(str, options)]


def finish(folder, *options):
    """The report of a run that nothing ends."""
    done = subprocess.run([*command(folder, "--json", *options)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def pixels(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels.copy() for name, channel in file.channels().items()}


def assert_same(one, other):
    assert one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


def checkpoints(folder):
    return {(path.name, path.stat().st_mtime_ns) for path in folder.glob("*.checkpoint") if path.exists()}


def interrupt(folder, chance, *options):
    """One run, ended by one of three signals: a quarter of them at any moment from its start, the others up to 0.1 s after it has
    written its first checkpoint. True where that ended a run that was rendering."""
    before = checkpoints(folder)
    process = subprocess.Popen(command(folder, "--resume", "--checkpoint", "0.01", *options), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    early = chance.random() < 0.25
    if not early:
        while process.poll() is None and not checkpoints(folder) - before:
            time.sleep(0.002)
    time.sleep(chance.uniform(0, 0.3 if early else 0.1))
    number = chance.choice([signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
    rendering = process.poll() is None and not early
    process.send_signal(number)
    errors = process.communicate(timeout=60)[1]
    assert errors == ""
    # While the scene loads, SIGINT and SIGTERM end the program as they do any other.
    assert process.returncode in (0, -number), process.returncode
    return rendering


def chain(folder, chance, count, whole):
    """Interrupts and resumes `count` times; whenever a picture is complete, it is compared and begun anew. How many were rendering."""
    write_scene(folder)
    rendering = 0
    for _ in range(count):
        rendering += interrupt(folder, chance, "--spp", SAMPLES)
        # A whole file has a temporary name while it takes an older one's place; a kill at that moment leaves it to the next run.
        names = {path.name for path in folder.iterdir() if ".tmp-" not in path.name}
        assert names <= {"scene.json", "out.exr", "out.exr.checkpoint"}, names
        if "out.exr" in names and pixels(folder / "out.exr")["samples"][0, 0] == SAMPLES:
            assert_same(pixels(folder / "out.exr"), whole)
            for name in names - {"scene.json"}:
                (folder / name).unlink()
    (folder / "out.exr.tmp-4194305").write_text("what a process that is no more has left")   # over the largest number of a process
    finish(folder, "--spp", SAMPLES, "--resume")
    assert_same(pixels(folder / "out.exr"), whole)
    assert not [path.name for path in folder.iterdir() if ".tmp-" in path.name]
    return rendering


def test_a_hundred_signals_at_random_moments_leave_whole_files_and_the_same_bits(tmp_path):
    write_scene(tmp_path)
    finish(tmp_path, "--spp", SAMPLES)
    whole = pixels(tmp_path / "out.exr")
    with ThreadPoolExecutor(2) as pool:
        chains = [pool.submit(chain, tmp_path / f"chain{k}", random.Random(k), INTERRUPTIONS // 2, whole) for k in range(2)]
        assert sum(one.result() for one in chains) > INTERRUPTIONS // 2


@pytest.mark.parametrize("program", ["selvedge-render", "selvedge-lookdev"])
def test_two_signals_at_once_are_one(tmp_path, program):
    """timeout(1) sends two: to the program and to its group. Seen red with a second one that always ends the program."""
    scene = write_scene(tmp_path) / "scene.json"
    line = [str(RENDER.with_name(program)), str(scene), "-o", str(tmp_path / "out.exr"), "-q", "--json", "--spp", "16777216", "--resolution", "512,512"]
    line += ["--headless"] if program == "selvedge-lookdev" else ["--checkpoint", "3600"]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, text=True)
    time.sleep(4)
    for _ in range(2):
        process.send_signal(signal.SIGTERM)
        time.sleep(0.01)
    said = process.communicate(timeout=60)[0]
    assert process.returncode == 0 and json.loads(said)["stopped_by"] == "signal" and (tmp_path / "out.exr").exists()


def test_a_later_signal_ends_at_once(tmp_path):
    """A program that has been asked to end and is still busy, with a frame of minutes."""
    scene = write_scene(tmp_path) / "scene.json"
    process = subprocess.Popen([str(RENDER.with_name("selvedge-lookdev")), str(scene), "-o", str(tmp_path / "out.exr"), "-q", "--headless",
                                "--frames", "9", "--footprint-samples", "64", "--resolution", "8192,8192"])
    time.sleep(6)
    process.send_signal(signal.SIGTERM)
    time.sleep(1)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    assert process.wait(10) == -signal.SIGTERM and not (tmp_path / "out.exr").exists()


def test_an_interrupted_turntable_goes_on_where_it_was(tmp_path):
    options = ["--turntable", 5, "--spp", SAMPLES]
    whole = write_scene(tmp_path / "whole")
    assert len(finish(whole, *options)["pictures"]) == 5
    folder, chance, ends = write_scene(tmp_path / "ended"), random.Random(5), 0
    while not (folder / "out_0003.exr").exists():
        ends += interrupt(folder, chance, *options)
    assert ends > 2
    done = {path.name: path.stat().st_mtime_ns for path in sorted(folder.glob("out_000[01].exr"))}
    report = finish(folder, *options, "--resume")
    assert report["complete_before"] + len(report["pictures"]) == 5 and report["complete_before"] >= 2
    assert all((folder / name).stat().st_mtime_ns == when for name, when in done.items()), "complete pictures are left as they are"
    for frame in range(5):
        assert_same(pixels(folder / f"out_{frame:04d}.exr"), pixels(whole / f"out_{frame:04d}.exr"))
    assert {path.name for path in folder.iterdir()} == {"scene.json", *(f"out_{frame:04d}.exr" for frame in range(5))}
    # Other work does not count as done.
    assert len(finish(folder, "--turntable", 5, "--spp", 16, "--resume")["pictures"]) == 5


@pytest.fixture
def small_disk(tmp_path):
    """(folder, limit) of a disk that is soon full: a file system of 64 KiB where that may be mounted, else a limit on files."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = shutil.which("mount") and subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", folder], capture_output=True).returncode == 0
    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))
    yield folder, None if mounted else limit
    if mounted:
        subprocess.run(["umount", folder], check=True)


def test_a_disk_that_fills_up_costs_a_message_and_nothing_else(tmp_path, small_disk):
    folder, limit = small_disk
    write_scene(folder)
    reference = write_scene(tmp_path / "whole")
    options = ["--spp", 256, "--resolution", "16,16"]
    finish(reference, *options)
    before = finish(folder, "--spp", 256, "--checkpoint", 10)   # a small picture fits, and its checkpoint
    assert before["samples"] == 256 * 64
    kept = {path.name: path.read_bytes() for path in folder.iterdir()}
    filler = folder / "filler"
    if limit is None:
        with open(filler, "wb", 0) as file:
            try:
                while file.write(b"0" * 512):
                    pass
            except OSError:
                pass
    (folder / "out.exr.checkpoint").rename(folder / "kept")
    done = subprocess.run(command(folder, *options, "--checkpoint", "0.001"), capture_output=True, text=True, preexec_fn=limit)
    assert done.returncode == 1 and done.stderr.startswith("selvedge-render: ") and done.stderr.count("\n") == 1, done.stderr
    assert (folder / "out.exr").read_bytes() == kept["out.exr"] and (folder / "kept").read_bytes() == kept["out.exr.checkpoint"]
    assert {path.name for path in folder.iterdir()} - {"filler"} == {"out.exr", "kept", "scene.json"}
    filler.unlink(missing_ok=True)
    finish(folder, *options, "--resume")
    assert_same(pixels(folder / "out.exr"), pixels(reference / "out.exr"))


def test_a_folder_that_goes_away_costs_a_message(tmp_path):
    folder = write_scene(tmp_path / "gone")
    process = subprocess.Popen(command(folder, "--time", "4"), stderr=subprocess.PIPE, text=True)
    time.sleep(2)   # the scene is read by then, on a busy machine too
    moved = folder.rename(tmp_path / "moved")
    errors = process.communicate(timeout=60)[1]
    assert process.returncode == 1 and errors.count("\n") == 1 and "found no folder" in errors, errors
    assert {path.name for path in moved.iterdir()} == {"scene.json"}
