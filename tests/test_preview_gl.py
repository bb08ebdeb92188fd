"""The preview on drivers that can less, and on ones that fail: GL 4.1, lost contexts, shaders that do not compile, limits.

Seen red with a 4.5 function in the 4.1 path (ClipControl called without asking), and with a lost context that nobody asks for."""
import json
import os
import pathlib
import shutil
import subprocess
import time

import numpy as np
import pytest

import evaluate
from preview_driver import drive, read
from test_preview import assert_same_mean
from test_window import PICTURE, Display

SCENES = evaluate.ROOT / "assets" / "scenes"
OLD = {"MESA_GL_VERSION_OVERRIDE": "4.1FC", "MESA_GLSL_VERSION_OVERRIDE": "410"}
# Stands between the program and the driver: the context is lost after some frames.
SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
typedef void (*function)(void);
static unsigned status(void)
{
    static int asked = 0;
    return getenv("LOSE_AFTER") && ++asked == atoi(getenv("LOSE_AFTER")) ? 0x8253 : 0;   /* GL_GUILTY_CONTEXT_RESET */
}
static void (*program_value)(unsigned, unsigned, int*);
static void slow_program_value(unsigned program, unsigned what, int* value)
{
    static time_t began = 0;
    program_value(program, what, value);
    if (what != 0x91B1) return;   /* GL_COMPLETION_STATUS_KHR */
    if (began == 0) began = time(NULL);
    *value = time(NULL) - began >= atoi(getenv("COMPILE_SECONDS"));
}
static function look_up(const char* of, const char* name)
{
    function found = ((function (*)(const char*))dlsym(RTLD_NEXT, of))(name);
    if (strcmp(name, "glGetGraphicsResetStatus") == 0) return (function)status;
    if (strcmp(name, "glGetProgramiv") != 0 || !getenv("COMPILE_SECONDS")) return found;
    program_value = (void (*)(unsigned, unsigned, int*))found;
    return (function)slow_program_value;
}
function eglGetProcAddress(const char* name) { return look_up("eglGetProcAddress", name); }
function glfwGetProcAddress(const char* name) { return look_up("glfwGetProcAddress", name); }
"""


def lookdev(folder, scene, *arguments, environment=None, status=0):
    done = subprocess.run([evaluate.BIN / "selvedge-lookdev", scene, "--headless", "-o", folder / "a.exr", "--json", "-q", *map(str, arguments)],
                          capture_output=True, text=True, timeout=300, env=os.environ | (environment or {}))
    assert done.returncode == status, done.stderr
    return json.loads(done.stdout) if status == 0 else done.stderr


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_gl_4_1_draws_the_same_picture(tmp_path, backend):
    common = ["--frames", 96, "--resolution", "32,32", "--backend", backend]
    report = lookdev(tmp_path, SCENES / "layers.json", *common, environment=OLD)
    assert report["gl"]["version"].startswith("4.1")
    os.rename(tmp_path / "a.exr", tmp_path / "old.exr")
    assert lookdev(tmp_path, SCENES / "layers.json", *common)["gl"]["version"].startswith("4.5")
    assert_same_mean(tmp_path / "old.exr", tmp_path / "a.exr")


def test_gl_4_0_is_refused_with_what_was_found(tmp_path):
    said = lookdev(tmp_path, SCENES / "sphere_matte.json", "--frames", 1, status=1,
                   environment={"MESA_GL_VERSION_OVERRIDE": "4.0FC", "MESA_GLSL_VERSION_OVERRIDE": "400"})
    assert "4.1" in said and not (tmp_path / "a.exr").exists()


@pytest.fixture(scope="module")
def shim(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shim")
    (folder / "shim.c").write_text(SHIM)
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", folder / "shim.so", folder / "shim.c", "-ldl"], check=True)
    return str(folder / "shim.so")


def test_a_lost_context_is_told_and_no_picture_is_written(tmp_path, shim):
    said = lookdev(tmp_path, SCENES / "sphere_matte.json", "--frames", 9, "--resolution", "16,16", "--backend", "egl", status=1,
                   environment={"LD_PRELOAD": shim, "LOSE_AFTER": "5"})
    assert "lost the context" in said and said.count("\n") == 1 and not (tmp_path / "a.exr").exists()


def test_a_window_that_has_lost_its_context_opens_another(tmp_path, shim, monkeypatch):
    monkeypatch.setenv("LD_PRELOAD", shim)
    monkeypatch.setenv("LOSE_AFTER", "6")
    with Display(tmp_path) as shown:
        assert "opening another window" in shown.program.stderr.readline()
        shown.wait_for("a picture", lambda: shown.picture()[PICTURE].std() > 0.02)
        assert shown.program.poll() is None


def test_a_window_answers_while_the_driver_compiles(tmp_path, shim, monkeypatch):
    """A driver that takes its time and says so: NVIDIA's takes 8 to 27 s. Seen red with a window that waits for it."""
    monkeypatch.setenv("LD_PRELOAD", shim)
    monkeypatch.setenv("COMPILE_SECONDS", "10")
    monkeypatch.setenv("SELVEDGE_CACHE", str(tmp_path / "cache"))   # empty: what comes from a cache is not waited for
    start = time.monotonic()
    with Display(tmp_path) as shown:
        shown.wait_for("the panel", lambda: shown.picture()[PICTURE][:, :200].std() > 0.02, 8)
        with_panel = shown.picture()[PICTURE]
        shown.tool("mousemove", 150, 60, "key", "p")
        shown.wait_for("no panel", lambda: np.abs(shown.picture()[PICTURE] - with_panel).mean() > 0.02, 3)
        below = np.s_[110:130, 80:160]   # the line that says what is going on
        assert shown.picture()[PICTURE][below].max() < 0.05 < shown.picture()[PICTURE].max() and time.monotonic() - start < 9
        shown.wait_for("a picture", lambda: shown.picture()[PICTURE][below].mean() > 0.05, 20)
    # Without a window there is nobody to answer.
    lookdev(tmp_path, SCENES / "sphere_matte.json", "--frames", 4, "--resolution", "16,16", "--backend", "egl")


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
@pytest.mark.parametrize("count", [None, 1])
def test_threads_of_software_gl_have_a_processor_each(tmp_path, backend, count):
    """If they are as many. Seen red without: every thread may use every processor, and short runs take up to 1.8 times as long."""
    ours = os.sched_getaffinity(0)
    environment = os.environ | ({"LP_NUM_THREADS": str(count)} if count else {})
    line = [evaluate.BIN / "selvedge-lookdev", SCENES / "sphere_matte.json", "--headless", "-o", tmp_path / "a.exr", "-q", "--time", "2", "--backend", backend]
    process = subprocess.Popen(line, env=environment)
    time.sleep(1.5)
    tasks = [int(task) for task in os.listdir(f"/proc/{process.pid}/task")]
    names = {task: pathlib.Path(f"/proc/{process.pid}/task/{task}/comm").read_text().strip() for task in tasks}
    allowed = [os.sched_getaffinity(task) for task, name in names.items() if name.startswith("llvmpipe-")]
    assert process.wait(60) == 0 and len(allowed) == (count or len(ours))
    if len(allowed) == len(ours):
        assert sorted(map(list, allowed)) == [[processor] for processor in sorted(ours)]
    else:
        assert all(one == ours for one in allowed)


def test_a_program_that_does_not_compile_leaves_the_last_good_one(tmp_path):
    """The model is changed to one whose shader is broken: the last good picture stays, until the model is one that works."""
    shutil.copytree(evaluate.ROOT / "glsl", tmp_path / "glsl")
    text = (tmp_path / "glsl" / "shade.frag").read_text()
    (tmp_path / "glsl" / "shade.frag").write_text(text + "\n#if MODEL_BSDF == 0\n#error no micro today\n#endif\n")
    environment = {"SELVEDGE_GLSL": str(tmp_path / "glsl")}
    drive(tmp_path, SCENES / "plane_plain.json", (24, 24), ["frames 24", "accumulated good.exr", "model bsdf 0", "frames 24", "accumulated kept.exr", "model bsdf 1", "frames 24",
           "accumulated again.exr"], environment)
    good, kept = read(tmp_path / "good.exr")[0], read(tmp_path / "kept.exr")[0]
    assert np.array_equal(good, kept) and good.mean() > 0.01
    assert np.array_equal(good, read(tmp_path / "again.exr")[0])


def test_a_picture_larger_than_the_driver_can_draw_is_refused(tmp_path):
    """16,384 is what llvmpipe can; one side of it is drawn, one pixel more is wrong use."""
    report = lookdev(tmp_path, SCENES / "sphere_matte.json", "--frames", 1, "--resolution", "16384,1")
    assert report["resolution"] == [16384, 1] and read(tmp_path / "a.exr")[0].shape == (1, 16384, 3)
    assert np.isfinite(read(tmp_path / "a.exr")[0]).all()
    assert "16384" in lookdev(tmp_path, SCENES / "sphere_matte.json", "--frames", 1, "--resolution", "16385,1", status=2)
