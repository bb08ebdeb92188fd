"""Suite ingredients: what each ingredient of the model gains and costs, from the paper's mode to ours. Run by ./dev bench ingredients.

One quiet rerun of everything: ./dev bench ingredients && build/venv/bin/python tests/bench_report.py"""
import argparse
import pathlib
import statistics
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import bench_report  # noqa: E402
from bench_report import figure  # noqa: E402

FABRICS = ("plain", "twill", "satin")
KINDS = ("none", "asg", "asg-lsq", "cap", "horizon8", "horizon16", "exact")
# Each step switches one ingredient; what follows a "+" is added to the step before.
LADDER = {
    "paper": {"mode": "paper"},
    "+horizon8": {"mode": "paper", "visibility": "horizon8"},
    "+tile": {"mode": "paper", "visibility": "horizon8", "weight": "tile"},
    "+resample": {"mode": "paper", "visibility": "horizon8", "weight": "resample"},
    "+relief": {"mode": "paper", "visibility": "horizon8", "weight": "relief"},
    "+unscattered": {"mode": "paper", "visibility": "horizon8", "weight": "relief", "unscattered": "true"},
    "+interreflection = ours": {"mode": "ours"},
}
FROM_PAPER = {
    "paper, visibility none": {"mode": "paper", "visibility": "none"},
    "paper, visibility asg-lsq": {"mode": "paper", "visibility": "asg-lsq"},
    "paper, weight tile": {"mode": "paper", "weight": "tile"},
    "paper, weight resample": {"mode": "paper", "weight": "resample"},
    "paper, weight relief": {"mode": "paper", "weight": "relief"},
    "paper, slab macro": {"mode": "paper", "slab": "macro"},
    "paper, unscattered": {"mode": "paper", "unscattered": "true"},
    "paper, interreflection": {"mode": "paper", "interreflection": "true"},
    "paper, no twist noise": {"mode": "paper", "twist_noise": "false"},
}
FROM_OURS = {
    "ours, weight mips": {"weight": "mips"},
    "ours, weight tile": {"weight": "tile"},
    "ours, weight resample": {"weight": "resample"},
    "ours, visibility none": {"visibility": "none"},
    "ours, visibility asg": {"visibility": "asg"},
    "ours, visibility asg-lsq": {"visibility": "asg-lsq"},
    "ours, slab macro": {"slab": "macro"},
    "ours, no unscattered": {"unscattered": "false"},
    "ours, no interreflection": {"interreflection": "false"},
    "ours, no twist noise": {"twist_noise": "false"},
}
BASE = {"micro": {"bsdf": "micro"}, "jin": {"mode": "jin"}}
GROUPS = {"ladder": LADDER, "paper": FROM_PAPER, "ours": FROM_OURS, "base": BASE}
MODELS = {name: keys for group in GROUPS.values() for name, keys in group.items()}
OURS, MICRO = "+interreflection = ours", "micro"
# A flash without shadows, where the model is nearly all there is to do; an environment and shadows; three fabrics in curtains.
SCENES = ("cylinder_satin", "demo", "curtain_fabrics")

LONG = {"fabrics": FABRICS, "texels": 256, "places": 2048, "samples": 16, "angles": (0, 30, 60, 75, 85), "footprints": (1, 4, 16, 64, 256),
        "directions": 4096, "rounds": 100, "processes": 5, "side": 256, "scenes": SCENES, "timed": tuple(MODELS)}
SHORT = LONG | {"fabrics": FABRICS[:1], "places": 1024, "samples": 8, "angles": (0, 75), "footprints": (1, 64), "directions": 512,
                "rounds": 24, "processes": 3, "side": 128, "scenes": SCENES[:1], "timed": (MICRO, "jin", "paper", OURS)}


def say(text):
    print(f"ingredients: {text}", file=sys.stderr)


def fabric_file(name):
    return bench_report.ROOT / "assets" / "fabrics" / f"{name}.json"


def measure_visibility(options):
    result = {}
    for fabric in options["fabrics"]:
        say(f"visibility, {fabric}")
        report = bench_report.run_program("selvedge-ingredients", "visibility", fabric_file(fabric), "--places", options["directions"],
                                          "--resolution", options["texels"],
                                          *(word for kind in KINDS for word in ("--kind", kind)))
        result[fabric] = {row.pop("kind"): row for row in report["kinds"]}
    return result


def name_on_the_line(model):
    return f"{model}:{','.join(f'{key}={value}' for key, value in MODELS[model].items())}"


def measure_reflectance(options):
    """{fabric: the program's report}; a model that has interreflection is held to all bounces, another to the first."""
    result = {}
    models = [word for model in MODELS for word in ("--model", name_on_the_line(model))]
    for fabric in options["fabrics"]:
        say(f"reflectance, {fabric}")
        result[fabric] = bench_report.run_program("selvedge-ingredients", "reflectance", fabric_file(fabric), *models,
                                                  "--resolution", options["texels"], "--places", options["places"], "--samples", options["samples"],
                                                  "--angles", *options["angles"], "--footprints", *options["footprints"])
    return result


def bounces(model):
    keys = MODELS[model]
    own = keys.get("interreflection")
    return "all" if own == "true" or (own is None and keys.get("mode", "ours") == "ours") else "once"


def cells(report, model, light, angle=None, footprint=None):
    return [cell["models"][model][f"{light}_{bounces(model)}"] for cell in report["cells"]
            if angle in (None, cell["angle"]) and footprint in (None, cell["footprint"])]


def take_turns(renderer, scene, models, rounds, options):
    """selvedge-turns' rows by model. Micro is the first: the others are held to it."""
    report = bench_report.run_program("selvedge-turns", bench_report.ROOT / "assets" / "scenes" / f"{scene}.json", "--renderer", renderer,
                                      "--side", options["side"], "--rounds", rounds,
                                      *(word for model in (MICRO, *models) for word in ("--model", name_on_the_line(model))))
    options["gl"] = report.get("gl", "")
    return {row.pop("model"): row for row in report["models"]}


def pair_row(runs):
    """Of processes that drew micro and ours alone: their medians, and the lowest and the highest ratio."""
    ratios = [run["over_first"] for run in runs]
    return {"nanoseconds": statistics.median(run["nanoseconds"] for run in runs), "over_first": statistics.median(ratios),
            "low": min(ratios), "high": max(ratios), "ratios": ratios}


def measure_cost(options):
    """{renderer: {scene: {model: row}}}: every model on the first scene, ours on the others. Ours and micro have processes of their own,
    several: what many models leave of the caches, and where one process puts its code and data, moves the ratio by a few percent."""
    result = {}
    for renderer in ("reference", "preview"):
        result[renderer] = {}
        for scene in options["scenes"]:
            say(f"cost, {renderer}, {scene}")
            others = [model for model in options["timed"] if model not in (MICRO, OURS)] if scene == SCENES[0] else []
            runs = [take_turns(renderer, scene, [OURS], options["rounds"] // options["processes"], options) for _ in range(options["processes"])]
            rows = take_turns(renderer, scene, others, options["rounds"], options) if others else {MICRO: runs[0][MICRO]}
            result[renderer][scene] = rows | {OURS: pair_row([run[OURS] for run in runs])}
    return result


def figures_of(visibility, reflectance, cost, options):
    figures = {}
    for kind in KINDS:
        rows = [fabric[kind] for fabric in visibility.values()]
        figures[f"visibility_rms.{kind}"] = figure(max(row["rms"] for row in rows), "", "lower", target=.17 if kind == "horizon8" else None,
                                                   runs=len(rows), note="worst fabric; V against exact rays")
        figures[f"visibility_bytes_per_texel.{kind}"] = figure(rows[0]["bytes_per_texel"], "bytes", "lower", target=2 if kind == "horizon8" else None,
                                                               note="and side")
        figures[f"visibility_ns.{kind}"] = figure(statistics.median(row["nanoseconds"] for row in rows), "ns", "lower", runs=9 * len(rows),
                                                  note="one look-up at a random texel, C++, one thread")
    for light in ("sky", "sun"):
        for model, label, target in ((OURS, "ours", .02), ("+horizon8", "paper_with_horizon8", None), ("paper", "paper", None)):
            here = [cell for report in reflectance.values() for cell in cells(report, model, light, 75, 1)]
            worst = max(here, key=lambda cell: abs(cell["error"]))
            figures[f"close_up_error_75.{light}.{label}"] = figure(abs(worst["error"]), "", "lower", target=target, runs=len(here),
                                                                   note=f"{worst['error']:+.3f} ± {worst['error_95']:.3f} (95 %), worst fabric; footprint 1 px")
        every = [cell for report in reflectance.values() for cell in cells(report, OURS, light)]
        worst = max(every, key=lambda cell: abs(cell["error"]))
        figures[f"worst_error.{light}.ours"] = figure(abs(worst["error"]), "", "lower", runs=len(every),
                                                      note=f"{worst['error']:+.3f} ± {worst['error_95']:.3f} (95 %), any angle, footprint, fabric")
    for renderer, scenes in cost.items():
        ratios = [ratio for models in scenes.values() for ratio in models[OURS]["ratios"]]
        figures[f"meso_over_micro.{renderer}"] = figure(statistics.median(ratios), "x", "lower", runs=len(ratios),
                                                        note=f"{min(ratios):.2f} to {max(ratios):.2f}; {options['processes']} processes a scene, {len(scenes)} scene(s)")
        for scene, models in scenes.items():
            for model, label in ((OURS, "ours"), ("paper", "paper"), ("jin", "jin")):
                if model not in models:
                    continue
                row = models[model]
                spread = f"lowest and highest of {options['processes']} processes" if model == OURS else "95 %"
                figures[f"meso_over_micro.{renderer}.{scene}.{label}"] = figure(
                    row["over_first"], "x", "lower", target=1.1 if label == "ours" else None, runs=options["rounds"],
                    note=f"{row['low']:.2f} to {row['high']:.2f} ({spread}); {row['nanoseconds']:.0f} ns a sample")
    return figures


def tables_of(visibility, reflectance, cost, options):
    """What tests/ingredient_tables.py makes a page of. Of each model it has only what it is held to: the truth with its bounces."""
    short = {}
    for fabric, report in reflectance.items():
        short[fabric] = report | {"cells": [cell | {"models": {
            model: {light: row[f"{light}_{bounces(model)}"] for light in ("sky", "sun")} | {"passes": row["passes"]}
            for model, row in cell["models"].items()}} for cell in report["cells"]]}
    return {"groups": {group: list(models) for group, models in GROUPS.items()}, "settings": MODELS,
            "bounces": {model: bounces(model) for model in MODELS}, "visibility": visibility, "reflectance": short,
            "cost": cost, "scenes": options["scenes"], "ours": OURS,
            "angles": options["angles"], "footprints": options["footprints"]}


def main():
    parser = argparse.ArgumentParser(description="What each ingredient of the model gains and costs.")
    parser.add_argument("--quick", action="store_true", help="one fabric, few samples: about a minute")
    parser.add_argument("--out", type=pathlib.Path, default=bench_report.ROOT / "out" / "bench", help="folder of the report")
    arguments = parser.parse_args()
    options = dict(SHORT if arguments.quick else LONG)
    load = bench_report.other_load()
    visibility = measure_visibility(options)
    reflectance = measure_reflectance(options)
    cost = measure_cost(options)
    figures = figures_of(visibility, reflectance, cost, options)
    tables = tables_of(visibility, reflectance, cost, options)
    bench_report.write("ingredients", figures, {}, out=arguments.out, load=load, gl=options.get("gl", ""), quick=arguments.quick, tables=tables)


if __name__ == "__main__":
    main()
