"""Runs selvedge-drive-preview, which moves and edits the preview as the window does; reads what it writes."""
import os
import subprocess

import numpy as np
import OpenEXR

import evaluate


def drive(folder, scene, size, commands, environment=None):
    """Runs the commands in `folder`. Returns the seconds of each `now`."""
    done = subprocess.run([evaluate.BIN / "selvedge-drive-preview", scene, "%d,%d" % size], input="\n".join(commands) + "\n", capture_output=True,
                          text=True, cwd=folder, timeout=600, env=os.environ | (environment or {}))
    assert done.returncode == 0, done.stderr
    return [float(word) for word in done.stdout.split()]


def read(path):
    """(rows, columns, 3) of R, G, B, and all channels by name."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: channel.pixels.astype("f8") for name, channel in file.channels().items()}
    return np.stack([channels[name] for name in "RGB"], -1), channels
