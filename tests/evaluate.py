"""Runs the rows of shared_rows.h: the shipped headers as C++ double (f64), C++ float (f32), and GLSL through EGL and OSMesa."""
import dataclasses
import os
import pathlib
import re
import subprocess

import moderngl
import numpy as np

import gl_contexts
import shader_source

ROOT = pathlib.Path(__file__).resolve().parents[1]
BIN = pathlib.Path(os.environ.get("SELVEDGE_BIN", ROOT / "build" / "bin"))
# $SELVEDGE_GLSL takes a changed copy of the headers: how the tests are seen red.
SOURCES = (pathlib.Path(os.environ.get("SELVEDGE_GLSL", ROOT / "glsl")), ROOT / "tests")
BUILDS = ("f64", "f32", *gl_contexts.BACKENDS)


@dataclasses.dataclass
class Row:
    name: str
    inputs: int
    outputs: int
    body: str


def read_rows(path=ROOT / "tests" / "shared_rows.h"):
    """ROW(name, inputs, outputs, statements) by name; a row is a line."""
    rows = {}
    for line in path.read_text().splitlines():
        hit = re.fullmatch(r"ROW\((\w+), (\d+), (\d+), (.*)\)", line)
        if hit:
            rows[hit[1]] = Row(hit[1], int(hit[2]), int(hit[3]), hit[4])
    return rows


ROWS = read_rows()


@dataclasses.dataclass
class Tables:
    """Maps of one fabric and the lights, in the words that the renderers keep. Texels are (h, w, 2) uint32; horizons (n, 2), as many
    as the largest kind of visibility asks for; yarns (n, 17) and lights (n, 19) are rows of numbers as shared_inputs.h reads them, and
    so are emitters (n, 13); environment (h, w, 4), inversion as inversion_table makes it; heights (w h) uint16, asg (n, 4), the same for both sides."""
    texels: tuple
    horizons: tuple
    mips: tuple
    yarns: np.ndarray
    lights: np.ndarray
    environment: np.ndarray
    inversion: np.ndarray
    heights: np.ndarray
    asg: np.ndarray
    emitters: np.ndarray

    @property
    def size(self):
        return self.texels[0].shape[1], self.texels[0].shape[0]

    @property
    def environment_size(self):
        return self.environment.shape[1], self.environment.shape[0]

    def write(self, path):
        """Counted arrays, in the order that cpp/evaluate_main.cpp reads them."""
        with open(path, "wb") as file:
            def put(array, kind, per_item):
                words = np.ascontiguousarray(array, kind)
                file.write(np.uint32(words.size // per_item).tobytes() + words.tobytes())
            put([*self.size, *self.environment_size], "i4", 1)
            for pair, width in ((self.texels, 2), (self.horizons, 2), (self.mips, 1)):
                for side in pair:
                    put(side, "u4", width)
            put(self.yarns, "f4", 1)
            put(self.lights, "f4", 1)
            put(self.environment, "f4", 1)
            put(self.inversion, "u4", 2)
            put(self.heights, "u2", 1)
            put(self.asg, "f4", 1)
            put(self.emitters, "f4", 1)


def inversion_table(density):
    """Shares of the texels of each row of a density, then of the rows: where each ends as a 32-bit fraction, and for each part of the
    fractions where to begin to look. Filled up to whole rows."""
    def shares(weights):
        n = len(weights)
        ends = np.minimum(np.cumsum(weights) / weights.sum() * 2.0**32, 2**32 - 1).astype(np.uint64)
        ends[-1] = 2**32 - 1
        lowest = -((-np.arange(n, dtype=object) * 2**32) // n)   # bits of each part
        return np.stack([ends, np.minimum(np.searchsorted(ends, lowest.astype(np.uint64), side="right"), n - 1)], -1).astype(np.uint32)
    h, w = density.shape
    table = np.zeros(((h + -(-h // w)) * w, 2), np.uint32)
    table[:w * h] = np.concatenate([shares(row) for row in density])
    table[w * h:w * h + h] = shares(density.sum(1))
    return table.reshape(-1, w, 2)


class CppEvaluator:
    def __init__(self, precision):
        self.precision = precision

    def run(self, row, xs, tables_path=None):
        command = [BIN / "selvedge-evaluate", row.name, self.precision] + ([tables_path] if tables_path else [])
        done = subprocess.run(command, input=np.ascontiguousarray(xs, "f8").tobytes(), stdout=subprocess.PIPE, check=True)
        return np.frombuffer(done.stdout, "f8").reshape(len(xs), row.outputs)


class GlslEvaluator:
    def __init__(self, backend):
        self.context = gl_contexts.Context(backend)
        self.programs = {}
        self.bound = None

    def bind(self, tables):
        """Puts the tables where cloth_fetch.h looks for them; returns the #defines of evaluate.comp."""
        gl = self.context.gl
        t = [np.hstack([np.ascontiguousarray(side, "u4").reshape(-1, 2) for side in both]) for both in (tables.texels, tables.horizons)]
        mips = [np.ascontiguousarray(side, "u4").ravel() for side in tables.mips]
        y, z = np.asarray(tables.yarns, "f4"), np.zeros((len(tables.yarns), 1), "f4")
        yarns = np.hstack([y[:, 13:15], z, np.tan(y[:, 15:16] / 2), y[:, 0:3], y[:, 12:13], y[:, 3:6], y[:, 16:17], y[:, 6:9], z, y[:, 9:12], z, np.tile(z, (1, 8))])
        v, z = np.asarray(tables.lights, "f4"), np.zeros((len(tables.lights), 1), "f4")
        lights = np.hstack([v[:, 2:5], v[:, 17:18], v[:, 5:8], v[:, 18:19], v[:, 8:11], z, v[:, 11:14], z, v[:, 14:17], z, v[:, 0:2], z, z])
        e = np.ascontiguousarray(tables.emitters, "f4")
        halves, corners = e[:, 9:].astype("u4"), e[:, :9].view("u4")
        alias = halves[:, 0::2] | (halves[:, 1::2] << 16)
        emitters = np.hstack([corners[:, 0:3], alias[:, :1], corners[:, 3:6], alias[:, 1:], corners[:, 6:9], 0 * alias[:, :1]])
        self.bound = [gl.buffer(np.ascontiguousarray(a).tobytes()) for a in (
            np.concatenate(t), np.concatenate(mips), yarns, lights, np.tile(np.asarray(tables.heights, "u2"), 2), np.tile(np.asarray(tables.asg, "f4"), (2, 1)), emitters)]
        formats = {1: gl_contexts.GL_RGBA32UI, 2: gl_contexts.GL_R32UI, 3: gl_contexts.GL_RGBA32F, 4: gl_contexts.GL_RGBA32F,
                   7: gl_contexts.GL_R16UI, 8: gl_contexts.GL_RGBA32F, 9: gl_contexts.GL_RGBA32UI}
        for buffer, (unit, internal_format) in zip(self.bound, formats.items()):
            self.context.bind_buffer_texture(unit, internal_format, buffer)
        for unit, (array, kind) in enumerate(((tables.environment, "f4"), (tables.inversion, "u4")), 5):
            texture = gl.texture(array.shape[1::-1], array.shape[2], np.ascontiguousarray(array, kind).tobytes(), dtype=kind)
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            texture.use(unit)
            self.bound.append(texture)
        return {"MAPS_SIZE": "%d, %d" % tables.size, "MAPS_TEXELS": "0", "MAPS_HORIZONS": str(len(t[0])), "MAPS_MIPS": f"0, {len(mips[0])}",
                "LIGHTS_COUNT": str(len(lights)), "LIGHTS_SIZE": "%d, %d" % tables.environment_size}

    def program(self, row, defines):
        key = (row.name, tuple(defines.values()))
        if key not in self.programs:
            defines = {"ROW_INPUTS": f"{row.inputs}u", "ROW_OUTPUTS": f"{row.outputs}u", "ROW_BODY": row.body} | defines
            files = []
            text = shader_source.load("evaluate.comp", SOURCES, files)
            source = "#version 450\n" + "".join(f"#define {name} {value}\n" for name, value in defines.items()) + text
            try:
                program = self.context.gl.compute_shader(source)
            except moderngl.Error as error:
                raise AssertionError(shader_source.readable(str(error), files)) from None
            for unit, name in enumerate(("map_words", "slope_words", "yarn_table", "light_table", "environment_map", "inversion_map", "height_words", "asg_table", "emitter_table"), 1):
                self.context.set_sampler(program, name, unit)
            self.programs[key] = program
        return self.programs[key]

    def run(self, row, xs, tables=None):
        with self.context as gl:
            nothing = {"MAPS_SIZE": "0", "MAPS_TEXELS": "0", "MAPS_HORIZONS": "0", "MAPS_MIPS": "0", "LIGHTS_COUNT": "0", "LIGHTS_SIZE": "0"}
            program = self.program(row, self.bind(tables) if tables else nothing)
            out = gl.buffer(reserve=4 * len(xs) * row.outputs)
            given = gl.buffer(np.ascontiguousarray(xs, "f4").tobytes())
            given.bind_to_storage_buffer(0)
            out.bind_to_storage_buffer(1)
            program.run(-(-len(xs) // 64))
            assert gl.error == "GL_NO_ERROR", gl.error
            result = np.frombuffer(out.read(), "f4").reshape(len(xs), row.outputs).astype("f8")
            given.release()
            out.release()
            for thing in self.bound or ():
                thing.release()
            self.bound = None
            return result


class Evaluator:
    """run(build, name, xs): the row `name` for each row of xs; contexts are made once, and none is made in vain."""

    def __init__(self, scratch):
        self.scratch = pathlib.Path(scratch)
        self.evaluators = {}

    def run(self, build, name, xs, tables=None):
        row = ROWS[name]
        xs = np.atleast_2d(np.asarray(xs, "f8"))
        assert xs.shape[1] == row.inputs, f"{name} takes {row.inputs} numbers, not {xs.shape[1]}"
        if build not in self.evaluators:
            self.evaluators[build] = GlslEvaluator(build) if build in gl_contexts.BACKENDS else CppEvaluator(build)
        if tables is not None and build not in gl_contexts.BACKENDS:
            path = self.scratch / f"tables-{id(tables)}.bin"
            if not path.exists():
                tables.write(path)
            tables = path
        return self.evaluators[build].run(row, xs, tables)
