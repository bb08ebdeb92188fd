"""Suite bake: seconds of each stage by size, growth, memory, the sweep against brute force, and what each kind of visibility costs and
gains. Run by ./dev bench bake."""
import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import bench_report  # noqa: E402
from bench_report import figure  # noqa: E402

STAGES = ("pattern", "maps", "visibility", "normals", "total")
KINDS = ("none", "horizon8", "horizon16", "cap", "asg", "asg-lsq", "exact")
FABRIC = bench_report.ROOT / "assets" / "fabrics" / "plain.json"
LONG = {"sizes": (64, 128, 256, 512, 1024), "runs": 7, "directions": 2048}
SHORT = {"sizes": (64, 128, 256, 512), "runs": 3, "directions": 256}


def say(text):
    print(f"bake: {text}", file=sys.stderr)


def bake(size, *options):
    """(the report of a bake from nothing, peak bytes of its process)."""
    command = [bench_report.BIN / "selvedge-bake", FABRIC, "--json", "--force", "--resolution", size, *options]
    with subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, text=True) as process:
        report = json.loads(process.stdout.read())
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}: exit status {process.returncode}")
    return report, usage.ru_maxrss * 1024


def measure_stages(options):
    """{size: {"texels", stage: [seconds, ...], "peak", "resident"}}."""
    result = {}
    for size in options["sizes"]:
        say(f"stages at {size} x {size}")
        runs = [bake(size) for _ in range(options["runs"])]
        result[size] = {stage: [report["seconds"][stage] for report, _ in runs] for stage in STAGES}
        result[size] |= {"texels": runs[0][0]["texels"][0] * runs[0][0]["texels"][1], "peak": [peak for _, peak in runs],
                         "resident": runs[0][0]["bytes"]["memory"]}
    return result


def measure_kinds(options):
    """{kind: row of selvedge-ingredients}, and the seconds that the bake of each takes besides the maps."""
    say("kinds of visibility")
    report = bench_report.run_program("selvedge-ingredients", "visibility", FABRIC, "--places", options["directions"], "--resolution", 256,
                                      *(word for kind in KINDS for word in ("--kind", kind)))
    return {row["kind"]: row for row in report["kinds"]}


def figures_of(stages, kinds, sweep, options):
    at, largest = stages[256], stages[max(stages)]
    runs = options["runs"]
    figures = {"total_seconds_256": figure(statistics.median(at["total"]), "s", "lower", target=.5, runs=runs,
                                           note=f"{min(at['total']):.3f} to {max(at['total']):.3f}; both sides, plain weave of 2-ply yarns; aim .1")}
    for stage in STAGES[:-1]:
        figures[f"{stage}_seconds_256"] = figure(statistics.median(at[stage]), "s", "lower", runs=runs)
    figures["resident_bytes_256"] = figure(at["resident"], "bytes", "lower", target=2e6, note="both sides; what a renderer uploads; aim 1.5e6")
    per_texel = {size: statistics.median(row["total"]) / row["texels"] for size, row in stages.items()}
    figures["growth_per_texel"] = figure(per_texel[max(stages)] / per_texel[256], "x", "lower", target=1.3, runs=runs,
                                         note=f"seconds a texel at {max(stages)} over those at 256")
    figures["peak_bytes_per_texel"] = figure((min(largest["peak"]) - min(stages[64]["peak"])) / (largest["texels"] - stages[64]["texels"]),
                                             "bytes", "lower", runs=runs, note=f"growth of the process's peak from 64 to {max(stages)}; both sides")
    row = sweep[256]
    figures["sweep_over_brute_force"] = figure(row["sweep_seconds"] / row["march_seconds"], "x", "lower", target=.5, runs=row["sweep_passes"],
                                               note=f"256 x 256; sweep {row['sweep_seconds']:.3f} s, marches {row['march_seconds']:.2f} s, "
                                                    f"{row['march_rows']} of {row['march_rows_of']} rows marched")
    for kind, row in kinds.items():
        figures[f"visibility_rms.{kind}"] = figure(row["rms"], "", "lower", target=.17 if kind == "horizon8" else None, runs=row["directions"],
                                                   note="runs: directions asked; V against exact rays")
        figures[f"visibility_bytes_per_texel.{kind}"] = figure(row["bytes_per_texel"], "bytes", "lower", note="and side")
        figures[f"visibility_ns.{kind}"] = figure(row["nanoseconds"], "ns", "lower", runs=9, note="one look-up at a random texel, C++, one thread")
    return figures


def curves_of(stages, sweep):
    curves = {}
    for stage in STAGES:
        curves[f"seconds.{stage}"] = [[row["texels"], statistics.median(row[stage]), min(row[stage]), max(row[stage])] for row in stages.values()]
    for name in ("sweep", "march"):
        curves[f"seconds.{name}"] = [[row["texels"][0] * row["texels"][1]] + [row[f"{name}_seconds"]] * 3 for row in sweep.values()]
    return curves


def main():
    parser = argparse.ArgumentParser(description="What a bake costs, by stage and size, and what each kind of visibility gains.")
    parser.add_argument("--quick", action="store_true", help="up to 512 x 512, few runs: about a minute")
    parser.add_argument("--out", type=pathlib.Path, default=bench_report.ROOT / "out" / "bench", help="folder of the report")
    arguments = parser.parse_args()
    options = SHORT if arguments.quick else LONG
    load = bench_report.other_load()
    with tempfile.TemporaryDirectory(prefix="selvedge-bench-") as folder:
        os.environ["SELVEDGE_CACHE"] = folder
        stages = measure_stages(options)
        say("the sweep against brute force")
        sweep = {size: bench_report.run_program("selvedge-ingredients", "sweep", FABRIC, "--resolution", size) for size in options["sizes"]}
        kinds = measure_kinds(options)
    curves = curves_of(stages, sweep)
    bench_report.write("bake", figures_of(stages, kinds, sweep, options), curves, out=arguments.out, load=load,
                       axes=("texels of a side", "seconds"), groups={"seconds": list(curves)}, quick=arguments.quick)


if __name__ == "__main__":
    main()
