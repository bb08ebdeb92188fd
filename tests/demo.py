"""What ./dev demo does once everything is built: bake, preview, reference, comparison, report. Runs the programs; works nothing
out itself. Standard library only."""
import json
import os
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[1]
BIN = pathlib.Path(os.environ.get("SELVEDGE_BIN", ROOT / "build" / "bin"))
OUT = pathlib.Path("out/demo")
SCENE = pathlib.Path("assets/scenes/demo.json")
FRAMES = 128
SAMPLES = 128


def run(program, *arguments):
    """The JSON object that a program prints; its messages and progress go to the terminal as they are."""
    done = subprocess.run([BIN / program, *map(str, arguments), "--json"], stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        sys.exit(1)   # the program has said why
    return json.loads(done.stdout)


def say(text):
    print(text, flush=True)


def main():
    os.chdir(ROOT)
    OUT.mkdir(parents=True, exist_ok=True)
    fabrics = [path for path in sorted(pathlib.Path("assets/fabrics").glob("*.json")) if ".schema" not in path.name]
    for fabric in fabrics:
        bake = run("selvedge-bake", fabric)
        size = " x ".join(map(str, bake["texels"]))
        say(f"{fabric}: {size} texels, {bake['seconds']['total']:.2f} s" + (", cached" if bake["cached"] else ""))
    report = {}
    say(f"preview: {SCENE}, {FRAMES} frames")
    report["preview"] = run("selvedge-lookdev", SCENE, "--headless", "-o", OUT / "preview.exr", "-o", OUT / "preview.png", "--frames", FRAMES)
    say(f"reference: {SCENE}, {SAMPLES} samples per pixel")
    report["reference"] = run("selvedge-render", SCENE, "-o", OUT / "reference.exr", "-o", OUT / "reference.png", "--spp", SAMPLES)
    # Two noisy pictures differ; how much is for the report to tell, not for a verdict.
    report["compare"] = run("selvedge-compare", OUT / "preview.exr", OUT / "reference.exr", "--heatmap", OUT / "error.png", "--fail", "max_abs=inf", "-q")
    (OUT / "report.json").write_text(json.dumps(report, indent=2) + "\n")
    print(f"{'':12}{'seconds':>10}{'samples per pixel':>20}")
    for name in ("preview", "reference"):
        print(f"{name:12}{report[name]['seconds']['render']:10.1f}{report[name]['spp_mean']:20.0f}")
    for metric in ("rmse", "relmse", "mean_relative_bias", "flip", "z_outliers"):
        if metric in report["compare"]:
            print(f"{metric:22}{report['compare'][metric]}")
    print("pictures:", OUT / "preview.png", OUT / "reference.png", OUT / "error.png")
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        print("the window: ./dev app")


if __name__ == "__main__":
    main()
