"""Pastes GLSL includes. app/preview/shader_source.cpp is its twin; test_layering.py holds their output equal."""
import pathlib
import re

INCLUDE = re.compile(r'\s*#include "([^"]+)"')


def load(name, roots, files):
    """The text of `name`, found in the first of `roots` that has it, with every #include pasted. `files` grows, so that
    `2:31` in a driver's log means files[2], line 31."""
    index = len(files)
    files.append(name)
    path = next((p for p in (pathlib.Path(root) / name for root in roots) if p.exists()), None)
    if path is None:
        raise FileNotFoundError(f"{name}: not in {', '.join(map(str, roots))}")
    out = [f"#line 1 {index}"]
    for number, line in enumerate(path.read_text().splitlines(), 1):
        hit = INCLUDE.match(line)
        out += [load(hit[1], roots, files), f"#line {number + 1} {index}"] if hit else [line]
    return "\n".join(out)


def readable(log, files):
    """'2:31(8): error' -> 'cloth_bsdf.h:31: error'; Mesa writes 2:31(8), NVIDIA 2(31)."""
    def place(match):
        index = int(match[1])
        return f"{files[index]}:{match[2] or match[3]}" if index < len(files) else match[0]
    return re.sub(r"\b(\d+)(?::(\d+)\(\d+\)|\((\d+)\))", place, log)
