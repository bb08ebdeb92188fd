"""Golden pictures of our scenes: long renders by the reference, kept with their variance. Remake them after a change that is meant to
change pictures, and say why in the commit:  build/venv/bin/python tests/goldens.py [NAME ...]"""
import subprocess
import sys

import evaluate

FOLDER = evaluate.ROOT / "tests" / "golden"
# A picture is small; what a change breaks shows in every pixel of its kind.
SIZE, SAMPLES = 32, 16384
NAMES = ("cylinder_satin", "demo", "layers", "plane_plain")


def scene(name):
    return evaluate.ROOT / "assets" / "scenes" / f"{name}.json"


def remake(name):
    subprocess.run([evaluate.BIN / "selvedge-render", scene(name), "-o", FOLDER / f"{name}.exr", "--spp", str(SAMPLES), "--seed", "90001",
                    "--integrator", "direct", "--resolution", f"{SIZE},{SIZE}", "-q"], check=True)


def main():
    names = sys.argv[1:] or NAMES
    for name in names:
        if name not in NAMES:
            sys.exit(f"goldens: no {name}; there are {', '.join(NAMES)}")
    FOLDER.mkdir(exist_ok=True)
    for name in names:
        remake(name)
        print(FOLDER / f"{name}.exr")


if __name__ == "__main__":
    main()
