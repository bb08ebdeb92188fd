"""Accumulation of 65,536 frames loses nothing: blocks of frames summed by the blend unit, folded into a mean by merge.frag, against a
sum in float64. Error under 1e-6, where one running sum in float32 is off by more than 1e-4.

Seen red with a mean whose roundings merge.frag does not keep: 1.9e-6."""
import json
import subprocess

import moderngl
import numpy as np
import OpenEXR

import evaluate
import gl_contexts
import shader_source

FRAMES, SIZE = 65536, 16

# Stands in for shade.frag: the frame's picture, from integers, so that numpy makes the same bits of it.
#   red     spikes: 16 octaves, any order
#   green   the same number in each frame: all roundings go the same way
#   blue    one bright frame in 64, the others dim
#   alpha   coverage
FRAME = """#version 450
#include "interop.h"
#include "random.h"
uniform uint frame;
layout(location = 0) out vec4 colour;

float number(uint bits)
{
    return float(bits >> 8u) * 5.9604644775390625e-8;
}

void main()
{
    uint pixel = uint(gl_FragCoord.y) * 16u + uint(gl_FragCoord.x);
    uint a = cloth_hash(pixel * 65536u + frame), b = cloth_hash(a ^ 0x68bc21ebu), c = cloth_hash(pixel);
    float bright = frame % 64u == pixel % 64u ? 4096.0 : 0.0009765625;
    colour = vec4(number(a) * exp2(float(int(b & 15u) - 8)), 1.0 + number(c), (1.0 + number(b)) * bright, 1.0);
}
"""


def hash32(x):
    x = x.astype(np.uint32)
    for shift, factor in ((16, 0x7feb352d), (15, 0x846ca68b), (16, 1)):
        x = (x ^ (x >> np.uint32(shift))) * np.uint32(factor)
    return x


def number(bits):
    return (bits >> np.uint32(8)) * 2.0**-24


def frames_of(first, count):
    """Pictures first .. first + count - 1: (count, pixels, 4) float64; each value is a float32."""
    pixel = np.arange(SIZE * SIZE, dtype=np.uint32)[None]
    frame = np.arange(first, first + count, dtype=np.uint32)[:, None]
    a = hash32(pixel * np.uint32(65536) + frame)
    b = hash32(a ^ np.uint32(0x68bc21eb))
    bright = np.where(frame % 64 == pixel % 64, 4096.0, 2.0**-10)
    green = np.broadcast_to(1 + number(hash32(pixel)), a.shape).astype("f4").astype("f8")
    return np.stack([number(a) * 2.0 ** ((b & np.uint32(15)).astype(int) - 8), green, (1 + number(b)).astype("f4").astype("f8") * bright,
                     np.ones(a.shape)], -1)


def program_of(gl, text, files):
    return gl.program(vertex_shader="#version 450\n" + shader_source.load("screen.vert", evaluate.SOURCES, files), fragment_shader=text)


def pasted(text, files):
    """The #includes of a text that is not a file."""
    return "\n".join(shader_source.load(line.split('"')[1], evaluate.SOURCES, files) if line.startswith("#include") else line
                     for line in text.splitlines())


def accumulate(frames, length):
    """Mean and spread as the preview has them after `frames` frames, a whole number of blocks: Passes::shade and ::merge."""
    context = gl_contexts.Context("egl")
    with context as gl:
        draw = program_of(gl, pasted(FRAME, []), [])
        merge = program_of(gl, "#version 450\n" + shader_source.load("merge.frag", evaluate.SOURCES, []), [])
        array = {program: gl.vertex_array(program, []) for program in (draw, merge)}
        texture = [gl.texture((SIZE, SIZE), 4, dtype="f4") for _ in range(7)]   # sum; mean, spread and rest, twice
        target = [gl.framebuffer(texture[:1]), gl.framebuffer(texture[1:4]), gl.framebuffer(texture[4:7])]
        for one in target:
            one.clear(0, 0, 0, 0)
        for unit, name in enumerate(("block_sum", "mean_map", "spread_map", "rest_map")):
            merge[name] = unit
        merge["block_length"] = length
        gl.blend_func = moderngl.ONE, moderngl.ONE
        gl.enable_only(moderngl.BLEND)
        side = 1
        target[0].use()
        for frame in range(frames):
            draw["frame"] = frame
            array[draw].render(moderngl.TRIANGLES, 3)
            if (frame + 1) % length == 0:
                gl.disable(moderngl.BLEND)
                for unit, k in enumerate((0, 3 * side - 2, 3 * side - 1, 3 * side)):
                    texture[k].use(unit)
                side = 3 - side
                target[side].use()
                merge["blocks"] = (frame + 1) // length
                array[merge].render(moderngl.TRIANGLES, 3)
                target[0].clear(0, 0, 0, 0)
                target[0].use()
                gl.enable(moderngl.BLEND)
        result = [np.frombuffer(target[side].read(components=4, attachment=k, dtype="f4"), "f4").reshape(-1, 4).astype("f8") for k in (0, 1)]
        for thing in (*texture, *target):
            thing.release()
    return result


def exact(frames, length):
    """Mean, sum of squared deviations of the blocks' means, and one running sum in float32, which would not do."""
    sums = np.empty((frames // length, SIZE * SIZE, 4))
    running = np.zeros((SIZE * SIZE, 4), "f4")
    for first in range(0, frames, 1024):
        part = frames_of(first, 1024)
        sums[first // length:(first + 1024) // length] = part.reshape(-1, length, *part.shape[1:]).sum(1)
        for picture in part.astype("f4"):
            running += picture
    means = sums / length
    mean = means.mean(0)
    return mean, ((means - mean) ** 2).sum(0), running.astype("f8") / frames


def test_65536_frames_lose_nothing():
    length = 64   # cloth_block_length of that many frames, and where nobody knows how many
    evaluator = evaluate.CppEvaluator("f64")
    for planned in (0, FRAMES):
        words = np.array([[planned & 0xffff, planned >> 16]], float)
        assert evaluator.run(evaluate.ROWS["block_length"], words)[0, 0] == length
    mean, spread = accumulate(FRAMES, length)
    want_mean, want_spread, running = exact(FRAMES, length)
    assert (want_mean > 0).all()
    error = np.abs(mean / want_mean - 1).max(0)
    print("relative errors of the channels", error)
    assert (error < 1e-6).all(), error
    assert error[3] == 0
    changing = [0, 2]
    assert np.abs(spread[:, changing] / want_spread[:, changing] - 1).max() < 1e-4   # the variance layer, a statistic
    # What the blocks are for.
    assert np.abs(running / want_mean - 1).max() > 1e-4


def test_a_picture_of_many_frames_keeps_its_value(program, tmp_path):
    """The preview itself: an environment of one colour stays that colour, with 15 blocks and an unfinished one."""
    colour = [0.1, 0.3, 7.7]
    scene = {"camera": {"position": [0, 0, 4], "target": [0, 0, 0], "fov": 30}, "film": {"resolution": [8, 8], "filter": "box"},
             "lights": [{"type": "environment", "colour": colour}],
             "objects": [{"shape": "sphere", "translate": [0, 0, 50], "scale": 0.5, "matte": {"albedo": [0.5, 0.5, 0.5]}}]}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    frames = 64 * 15 + 40
    done = subprocess.run([program("lookdev"), tmp_path / "scene.json", "--headless", "--frames", str(frames), "-o", tmp_path / "out.exr",
                           "--json", "-q"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["frames"] == frames and report["block_length"] > 1 and frames % report["block_length"] != 0
    channels = OpenEXR.File(str(tmp_path / "out.exr"), separate_channels=True).channels()
    for name, value in zip("RGB", colour):
        got = np.asarray(channels[name].pixels, "f8")
        assert np.abs(got / np.float32(value) - 1).max() < 1e-6, name
        assert np.sqrt(np.asarray(channels[f"variance.{name}"].pixels, "f8")).max() < 1e-6 * value
