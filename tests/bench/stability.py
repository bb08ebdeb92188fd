"""Suite stability: the shared functions on inputs that hunt trouble. No result may be NaN, infinite or outside its range; the error
of float against double is told as quantiles. Run by ./dev bench stability.

The inputs, C++ and the verdicts are selvedge-stability's (tests/cpp/stability_main.cpp); GLSL runs the same inputs here."""
import argparse
import json
import pathlib
import subprocess
import sys
import time

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import bench_report  # noqa: E402
import evaluate  # noqa: E402

PROGRAM = evaluate.BIN / "selvedge-stability"
BATCH = 1 << 15
# Inputs over all functions. OSMesa is the same rasteriser as EGL's software driver with another door.
LONG = {"cpp": 100_000_000, "egl": 10_000_000, "osmesa": 1_000_000}
SHORT = {"cpp": 1_000_000, "egl": 100_000, "osmesa": 50_000}


def run_program(*arguments, data=None, allowed=(0,)):
    """What selvedge-stability prints, as bytes, and its exit status."""
    done = subprocess.run([PROGRAM, *map(str, arguments)], input=data, stdout=subprocess.PIPE)
    if done.returncode not in allowed:
        raise RuntimeError(f"selvedge-stability {' '.join(map(str, arguments))}: exit status {done.returncode}")
    return done.stdout


def cpp_statistics(count, functions=()):
    """{function: statistics} of C++ float against double."""
    chosen = ["--functions", ",".join(functions)] if functions else []
    return json.loads(run_program("--count", count, *chosen, allowed=(0, 1)))


def replay(function, index):
    return json.loads(run_program("--replay", function, index))


def read_rows():
    """The rows under test: those of tests/shared_rows.h and those of tests/cpp/stability_rows.hpp."""
    return evaluate.ROWS | evaluate.read_rows(evaluate.ROOT / "tests" / "cpp" / "stability_rows.hpp")


def read_tables():
    """The maps and lights of selvedge-stability."""
    data = run_program("--tables")
    first = 0

    def take(kind, per_item=1):
        nonlocal first
        count = int(np.frombuffer(data, "u4", 1, first)[0])
        array = np.frombuffer(data, kind, count * per_item, first + 4)
        first += 4 + array.nbytes
        return array.reshape(-1, per_item) if per_item > 1 else array

    w, h, ew, eh = take("i4")
    texels = tuple(take("u4", 2).reshape(h, w, 2) for _ in range(2))
    horizons = tuple(take("u4", 2) for _ in range(2))
    mips = tuple(take("u4") for _ in range(2))
    yarns, lights = take("f4").reshape(-1, 17), take("f4").reshape(-1, 19)
    environment, inversion = take("f4").reshape(eh, ew, 4), take("u4", 2).reshape(-1, ew, 2)
    return evaluate.Tables(texels, horizons, mips, yarns, lights, environment, inversion, take("u2"), take("f4").reshape(-1, 4),
                           take("f4").reshape(-1, 13))


class Glsl(evaluate.GlslEvaluator):
    """The evaluator of the tests on these tables."""

    def __init__(self, backend):
        super().__init__(backend)
        self.tables = read_tables()
        self.rows = read_rows()

    def name(self):
        with self.context as gl:
            return f"{gl.info['GL_RENDERER']}, {gl.info['GL_VERSION']}"

    def results(self, function, first, count):
        row = self.rows[function]
        data = run_program("--inputs", function, first, count)
        return self.run(row, np.frombuffer(data, "f4").reshape(count, row.inputs), self.tables)

    def statistics(self, function, count):
        """Of `count` inputs of a function. The shader's results go to selvedge-stability in one piece: quantiles do not add up."""
        parts = [self.results(function, first, min(BATCH, count - first)) for first in range(0, count, BATCH)]
        results = np.concatenate(parts).astype("f4")
        return json.loads(run_program("--judge", function, 0, count, data=results.tobytes(), allowed=(0, 1)))


def glsl_statistics(backend, count, functions=None, say=lambda text: None):
    """{function: statistics} of GLSL against double, and the driver's name."""
    glsl = Glsl(backend)
    functions = functions or list(glsl.rows)
    each = -(-count // len(functions))
    found = {}
    for function in functions:
        start = time.monotonic()
        found[function] = glsl.statistics(function, each)
        say(f"{backend}: {function}, {time.monotonic() - start:.1f} s")
    return found, glsl.name()


def bad_results(statistics):
    return sum(entry["not_finite"] + entry["out_of_range"] for entry in statistics.values())


def figures_of(build, statistics):
    inputs = sum(entry["inputs"] for entry in statistics.values())
    total = {key: sum(entry[key] for entry in statistics.values()) for key in ("not_finite", "out_of_range", "flipped", "unexplained")}
    figure = bench_report.figure
    return {f"{build}.inputs": figure(inputs, "", "higher", note=f"{len(statistics)} functions"),
            f"{build}.not_finite": figure(total["not_finite"], "", "lower", target=0, note="NaN or infinite results"),
            f"{build}.out_of_range": figure(total["out_of_range"], "", "lower", target=0, note="negative, above 1 for a share, not of unit length"),
            f"{build}.flipped": figure(total["flipped"] / inputs, "", "lower", note="share of inputs on which float decided otherwise than double"),
            f"{build}.unexplained": figure(total["unexplained"] / inputs, "", "lower",
                                           note="share of inputs whose error exceeds 2e-5 and 10 times what 4 ulp of the input make")}


def parse_options():
    parser = argparse.ArgumentParser(description="Shared functions on inputs that hunt trouble.")
    parser.add_argument("--quick", action="store_true", help="the short form: a minute")
    parser.add_argument("--out", type=pathlib.Path, default=bench_report.ROOT / "out" / "bench", help="folder of the report")
    for build, count in LONG.items():
        parser.add_argument(f"--{build}", type=int, help=f"inputs, 0: none; default {count}, short form {SHORT[build]}")
    options = parser.parse_args()
    for build, count in (SHORT if options.quick else LONG).items():
        if getattr(options, build) is None:
            setattr(options, build, count)
    return options


def main():
    options = parse_options()
    load = bench_report.other_load()
    found, names, seconds = {}, [], {}
    for build in LONG:
        if getattr(options, build) == 0:
            continue
        start = time.monotonic()
        if build == "cpp":
            found[build] = cpp_statistics(options.cpp)
        else:
            found[build], name = glsl_statistics(build, getattr(options, build), say=lambda text: print(f"stability: {text}", file=sys.stderr))
            names.append(f"{build}: {name}")
        seconds[build] = time.monotonic() - start
    figures = {}
    for build, statistics in found.items():
        figures |= figures_of(build, statistics)
    worst = {build: {function: replay(function, entry["worst_index"]) for function, entry in statistics.items() if entry["max"] > 2e-5}
             for build, statistics in found.items()}
    bench_report.write("stability", figures, {}, out=options.out, load=load, gl="; ".join(names), quick=options.quick, functions=found,
                       seconds=seconds, worst_inputs=worst)
    bad = {build: {function: entry["bad"] for function, entry in statistics.items() if entry["bad"]} for build, statistics in found.items()}
    for build, functions in bad.items():
        for function, indices in functions.items():
            print(f"stability: {build}: {function} has results that are none; selvedge-stability --replay {function} {indices[0]}", file=sys.stderr)
    return 1 if any(map(bad_results, found.values())) else 0


if __name__ == "__main__":
    sys.exit(main())
