"""Makes sky.exr: clear-sky radiance without the sun, as a latitude-longitude map, linear Rec.709, half floats.

Run by people: `python3 assets/lights/make_sky.py` writes sky.exr beside itself and prints the sun that belongs to it.

Sky: Preetham, Shirley, Smits 1999, "A Practical Analytic Model for Daylight", appendix 2 (Perez form, luminance in
kcd/m^2 and CIE chromaticity). Sun: the same paper's transmittance (Rayleigh and Angstrom aerosol terms) at one
wavelength for each colour. One scale and one white balance for both: in an open field, sky and sun together give an
upward surface neutral irradiance, and 1 unit of radiance is KCD_PER_UNIT kcd/m^2.

A direction d = (x, y, z), y up, lies at u = 0.5 + atan2(x, -z) / (2 pi), v = acos(y) / pi; v = 0 is the first row.
"""
import argparse
import pathlib
import struct

import numpy as np

HERE = pathlib.Path(__file__).parent
KCD_PER_UNIT = 16.0
EXTRATERRESTRIAL_KLX = 133.0  # sunlight above the atmosphere
REC709_FROM_XYZ = np.array([[3.2404542, -1.5371385, -0.4985314],
                            [-0.9692660, 1.8760108, 0.0415560],
                            [0.0556434, -0.2040259, 1.0572252]])


def perez(cos_theta, cos_gamma, gamma, a, b, c, d, e):
    """Perez et al. 1993 all-weather form F(theta, gamma), relative."""
    return (1 + a * np.exp(b / cos_theta)) * (1 + c * np.exp(d * gamma) + e * cos_gamma * cos_gamma)


def sky_xyz(directions, sun, turbidity):
    """Sky of unit directions (..., 3) with y >= 0 -> CIE XYZ (..., 3), Y in kcd/m^2. sun: unit, toward the sun."""
    t = turbidity
    theta_s = np.arccos(sun[1])
    # at the horizon the Perez gradient divides by zero; half a degree above it is as far as the fit was made
    cos_theta = np.maximum(directions[..., 1], 0.0087)
    cos_gamma = np.clip(directions @ sun, -1, 1)
    gamma = np.arccos(cos_gamma)
    # slope and offset over turbidity of Perez' a to e
    fits = {
        "Y": [(0.1787, -1.4630), (-0.3554, 0.4275), (-0.0227, 5.3251), (0.1206, -2.5771), (-0.0670, 0.3703)],
        "x": [(-0.0193, -0.2592), (-0.0665, 0.0008), (-0.0004, 0.2125), (-0.0641, -0.8989), (-0.0033, 0.0452)],
        "y": [(-0.0167, -0.2608), (-0.0950, 0.0092), (-0.0079, 0.2102), (-0.0441, -1.6537), (-0.0109, 0.0529)],
    }
    coefficients = {k: [slope * t + offset for slope, offset in fit] for k, fit in fits.items()}
    s3 = np.array([theta_s**3, theta_s**2, theta_s, 1])
    t3 = np.array([t * t, t, 1])
    chi = (4 / 9 - t / 120) * (np.pi - 2 * theta_s)
    zenith = {
        "Y": (4.0453 * t - 4.9710) * np.tan(chi) - 0.2155 * t + 2.4192,
        "x": t3 @ np.array([[0.00166, -0.00375, 0.00209, 0], [-0.02903, 0.06377, -0.03202, 0.00394],
                            [0.11693, -0.21196, 0.06052, 0.25886]]) @ s3,
        "y": t3 @ np.array([[0.00275, -0.00610, 0.00317, 0], [-0.04214, 0.08970, -0.04153, 0.00516],
                            [0.15346, -0.26756, 0.06670, 0.26688]]) @ s3,
    }
    value = {k: zenith[k] * perez(cos_theta, cos_gamma, gamma, *p) / perez(1.0, sun[1], theta_s, *p)
             for k, p in coefficients.items()}
    x, y, luminance = value["x"], value["y"], value["Y"]
    return np.stack([x / y * luminance, luminance, (1 - x - y) / y * luminance], -1)


def sun_klx(sun, turbidity):
    """Irradiance of the sun's disc on a plane that faces it, linear Rec.709 (3,), in kilolux."""
    elevation = np.degrees(np.arcsin(sun[1]))
    mass = 1 / (sun[1] + 0.15 * (elevation + 3.885) ** -1.253)
    wavelength_um = np.array([0.610, 0.550, 0.465])
    rayleigh = np.exp(-0.008735 * wavelength_um**-4.08 * mass)
    aerosol = np.exp(-(0.04608 * turbidity - 0.04586) * wavelength_um**-1.3 * mass)
    return EXTRATERRESTRIAL_KLX * rayleigh * aerosol


def write_half_exr(path, pixels):
    """OpenEXR 2 scan lines, HALF, not compressed: written here so that no library's compressor decides the bytes.

    pixels (h, w, 3), linear Rec.709. Layout: openexr.com, "OpenEXR File Layout".
    """
    height, width, _ = pixels.shape

    def attribute(name, kind, value):
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    channels = b"".join(c.encode() + b"\0" + struct.pack("<iB3xii", 1, 0, 1, 1) for c in "BGR") + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = struct.pack("<2i", 20000630, 2) + b"".join([
        attribute("channels", "chlist", channels),
        attribute("chromaticities", "chromaticities", struct.pack("<8f", .64, .33, .30, .60, .15, .06, .3127, .3290)),
        attribute("comments", "string", b"made by assets/lights/make_sky.py"),
        attribute("compression", "compression", b"\0"),
        attribute("dataWindow", "box2i", box),
        attribute("displayWindow", "box2i", box),
        attribute("envmap", "envmap", b"\0"),
        attribute("lineOrder", "lineOrder", b"\0"),
        attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
        attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
    ]) + b"\0"
    planar = np.ascontiguousarray(pixels[:, :, ::-1].transpose(0, 2, 1)).astype("<f2")
    row_bytes = planar[0].nbytes
    first = len(header) + 8 * height
    offsets = first + np.arange(height) * (row_bytes + 8)
    rows = b"".join(struct.pack("<2i", y, row_bytes) + planar[y].tobytes() for y in range(height))
    beside = path.with_suffix(".exr.part")
    beside.write_bytes(header + offsets.astype("<u8").tobytes() + rows)
    beside.replace(path)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--toward-sun", type=float, nargs=3, default=(-0.80, 0.50, -0.31), metavar=("X", "Y", "Z"))
    parser.add_argument("--turbidity", type=float, default=3.5, help="2 very clear .. 6 haze")
    parser.add_argument("--ground-albedo", type=float, default=0.17, help="of the lower half of the map")
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("-o", "--out", type=pathlib.Path, default=HERE / "sky.exr")
    options = parser.parse_args()
    sun = np.array(options.toward_sun)
    sun /= np.sqrt(sun @ sun)

    width, height = options.width, options.width // 2
    # box mean of 4 x 4 directions a pixel; the last axis is the direction
    fine = 4
    u = (np.arange(width * fine) + 0.5) / (width * fine)
    v = (np.arange(height * fine) + 0.5) / (height * fine)
    phi, theta = np.meshgrid((u - 0.5) * 2 * np.pi, v * np.pi)
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], -1)
    up = d[..., 1] > 0
    rgb = np.zeros(d.shape)
    rgb[up] = np.maximum(sky_xyz(d[up], sun, options.turbidity) @ REC709_FROM_XYZ.T, 0)

    solid_angle = np.sin(theta) * (2 * np.pi / u.size) * (np.pi / v.size)
    from_sky = (rgb * (np.maximum(d[..., 1], 0) * solid_angle)[..., None]).sum((0, 1))
    direct = sun_klx(sun, options.turbidity)
    total = from_sky + direct * sun[1]
    balance = total @ np.array([0.2126, 0.7152, 0.0722]) / total / KCD_PER_UNIT
    rgb *= balance
    rgb[~up] = options.ground_albedo * (total * balance) / np.pi
    rgb = rgb.reshape(height, fine, width, fine, 3).mean((1, 3))
    write_half_exr(options.out, rgb)

    def show(numbers):
        return "[" + ", ".join(f"{x:.3f}" for x in numbers) + "]"
    print(f"sun: direction {show(-sun)}, irradiance {show(direct * balance)}")
    least, most = rgb[:height // 2].min(), rgb.max()
    print(f"sky: horizontal irradiance {show(from_sky * balance)}, radiance {least:.3f} to {most:.3f}")


if __name__ == "__main__":
    main()
