"""Lights, lens and metal against closed forms, through both programs; tests/cpp/integrator_test.cpp has the other kinds of lights.

A picture's own variance tells noise from bias: means are held to 4.5 sigma of themselves, one chance in 100,000, with fixed seeds.
Seen red with emitters that shine from both sides, with a triangle's area taken for its light's, with Smith's masking left out of
the metal, and with the two strategies of MIS added without the one's density in the other's weight."""
import json
import pathlib
import subprocess

import numpy as np
import OpenEXR
import pytest

import cloth_oracle as oracle
import test_equality
import test_sampling

ROOT = pathlib.Path(__file__).parents[1]
FABRICS = sorted(path for path in (ROOT / "assets" / "fabrics").glob("*.json") if ".schema." not in path.name)
RENDERERS = {"preview": ("lookdev", "--headless", "--frames"), "direct": ("render", "--integrator", "direct", "--spp"),
             "path": ("render", "--integrator", "path", "--spp")}
SIGMAS = 4.5


def render(program, folder, scene, how, samples, side=16, *options):
    """Channels by name, each (side, side), and the report."""
    verb, *words = RENDERERS[how]
    (folder / "scene.json").write_text(json.dumps(scene))
    done = subprocess.run([str(program(verb)), str(folder / "scene.json"), *words, str(samples), "-o", str(folder / "out.exr"), "--json", "-q",
                           "--resolution", f"{side},{side}", *options], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    with OpenEXR.File(str(folder / "out.exr"), separate_channels=True) as file:
        return {name: channel.pixels.astype("f8") for name, channel in file.channels().items()}, json.loads(done.stdout)


def mean(channels, name="G"):
    """Mean of a channel over the picture, and its standard deviation."""
    return channels[name].mean(), np.sqrt(channels[f"variance.{name}"].mean() / channels[name].size)


def assert_mean(channels, expected, exact=1e-4, name="G"):
    """`exact`: relative, what the scene itself is off by (a sphere of triangles)."""
    value, sigma = mean(channels, name)
    assert sigma < 0.01 * expected, f"too noisy to tell: {value:.5g} +- {sigma:.2g}"
    assert abs(value - expected) < SIGMAS * sigma + exact * expected, f"{value:.6g} +- {sigma:.2g}, expected {expected:.6g}"


def floor(lights, *objects, material=None):
    """A patch of floor at 0, seen from above through a keyhole."""
    return {"camera": {"position": [0, 0.5, 0], "target": [0, 0, 0], "up": [0, 0, -1], "fov": 0.05}, "lights": lights,
            "objects": [{"shape": "plane", "scale": 40, **(material or {"matte": {"albedo": 0.5}})}, *objects]}


def rectangle_irradiance(a, b, h):
    """Of a parallel rectangle 2a x 2b of radiance 1 at height h over its middle: Howell's catalogue of view factors, B-4."""
    x, y = a / h, b / h
    u, v = np.hypot(1, x), np.hypot(1, y)
    return 2 * (x / u * np.arctan(y / u) + y / v * np.arctan(x / v))


# A closed sphere of radius r at height h: pi (r / h)^2, as if all of it were in its middle.
EMITTERS = {
    "sphere": ([], [{"shape": "sphere", "scale": 0.5, "translate": [0, 2, 0], "emission": [3, 2, 1]}], 2 * np.pi / 16, 1e-3),
    "seen rectangle": ([{"type": "area", "position": [0, 2, 0], "target": [0, 0, 0], "size": [2, 1], "radiance": [3, 2, 1], "visible": True}], [],
                       2 * rectangle_irradiance(1, 0.5, 2), 1e-5),
    "unseen rectangle": ([{"type": "area", "position": [0, 2, 0], "target": [0, 0, 0], "size": [2, 1], "radiance": [3, 2, 1]}], [],
                         2 * rectangle_irradiance(1, 0.5, 2), 1e-5),
    "plane": ([], [{"shape": "plane", "scale": [2, 1, 1], "rotate": [180, 0, 0], "translate": [0, 2, 0], "emission": [3, 2, 1]}],
              2 * rectangle_irradiance(1, 0.5, 2), 1e-5),
}


@pytest.mark.parametrize("how", RENDERERS)
@pytest.mark.parametrize("kind", EMITTERS)
def test_an_emitter_lights_a_floor_as_its_view_factor_says(program, tmp_path, kind, how):
    lights, objects, irradiance, exact = EMITTERS[kind]
    channels, _ = render(program, tmp_path, floor(lights, *objects), how, 256)
    assert_mean(channels, 0.5 * irradiance / np.pi, exact)
    assert abs(channels["R"].mean() / channels["G"].mean() - 1.5) < 1e-3, "its colour"


@pytest.mark.parametrize("how", ["preview", "path"])
def test_an_emitter_is_seen_from_its_front_alone(program, tmp_path, how):
    scene = {"camera": {"position": [0, 1, 0], "target": [0, 0, 0], "up": [0, 0, -1], "fov": 10},
             "objects": [{"shape": "plane", "emission": [3, 2, 1]}]}
    channels, _ = render(program, tmp_path, scene, how, 16)
    assert np.allclose(channels["G"], 2, rtol=1e-6) and np.allclose(channels["R"], 3, rtol=1e-6)
    scene["objects"][0]["rotate"] = [180, 0, 0]
    channels, _ = render(program, tmp_path, scene, how, 16)
    assert (channels["G"] == 0).all()


@pytest.mark.parametrize("how", RENDERERS)
def test_few_lights_are_all_asked_and_one_of_the_rest(program, tmp_path, how):
    """Lights of one direction each: what they bring is known, so that all noise comes from choosing among them."""
    def suns(count):
        return [{"type": "directional", "direction": [.1 * k, -1, .05 * k], "irradiance": 1 + k, "angular_diameter": 0} for k in range(count)]
    def expected(count):
        return .5 / np.pi * sum((1 + k) / np.sqrt(1 + (.1 * k) ** 2 + (.05 * k) ** 2) for k in range(count))
    few, _ = render(program, tmp_path, floor(suns(4)), how, 64)
    assert np.allclose(few["G"], expected(4), rtol=1e-5) and few["variance.G"].max() < 1e-12
    many, _ = render(program, tmp_path, floor(suns(6)), how, 64)
    assert_mean(many, expected(6))
    assert many["variance.G"].mean() > 1e-8   # three of the six share the last slot


def test_flash_falls_with_the_square_of_the_distance_and_with_the_cosine_of_its_aim(program, tmp_path):
    values = []
    for distance, aim in ((1, 0), (2, 0), (1, 0.75)):   # aim beside the middle: cosine 1 / hypot(1, 0.75) = 0.8
        light = {"type": "flash", "position": [0, distance, 0], "target": [aim, 0, 0], "intensity": 4}
        values.append(mean(render(program, tmp_path, floor([light]), "direct", 16)[0])[0])
    assert np.allclose(values, [4 * 0.5 / np.pi, 0.5 / np.pi, 0.8 * 4 * 0.5 / np.pi], rtol=1e-5)


@pytest.mark.parametrize("how", ["preview", "direct"])
def test_a_hundred_lights_add_up_and_the_bright_one_is_asked_more_often(program, tmp_path, how):
    rng = np.random.default_rng(3)
    places, intensities = rng.uniform([-2, 1, -2], [2, 3, 2], (100, 3)), np.r_[60, rng.uniform(0.01, 0.1, 99)]
    lights = [{"type": "point", "position": list(map(float, p)), "intensity": float(i)} for p, i in zip(places, intensities)]
    values = intensities * places[:, 1] / np.linalg.norm(places, axis=1) ** 3 * 0.5 / np.pi
    channels, _ = render(program, tmp_path, floor(lights), how, 1024)
    assert_mean(channels, values.sum())
    # Variance of one sample if all lights were as likely, over what the picture says: the gain of choosing by importance.
    evenly = 100 * (values**2).sum() - values.sum() ** 2
    assert channels["variance.G"].mean() * 1024 < 0.02 * evenly


# ---- metal --------------------------------------------------------------------------------------------------------------------

def metal_albedo(colour, alpha, cosine):
    """Reflected share of a white sky: the mean weight F G2 / G1 over the visible normals, which a grid of u in 512 x 512 samples."""
    n = 512
    u = (np.stack(np.meshgrid(np.arange(n), np.arange(n)), -1).reshape(-1, 2) + 0.5) / n
    o = np.broadcast_to([np.sqrt(1 - cosine**2), 0, cosine], (len(u), 3))
    a = np.full(len(u), alpha)
    i, pdf = oracle.metal_sample(a, o, u)
    value = oracle.metal_value(np.full((len(u), 1), colour), a, i, o)[:, 0]
    return np.where(pdf > 0, value / np.where(pdf > 0, pdf, 1), 0).mean()


@pytest.mark.parametrize("how", ["preview", "path"])
@pytest.mark.parametrize("alpha", [0.001, 0.05, 0.4, 1.0])
def test_metal_in_a_white_furnace_reflects_its_albedo(program, tmp_path, alpha, how):
    """Under an angle of 60 degrees. At alpha 0.001 it is a mirror: all of the sky times Schlick's reflectance."""
    scene = floor([{"type": "environment", "colour": 1}], material={"metal": {"colour": 0.8, "roughness": alpha}})
    scene["camera"] |= {"position": [0, 0.25, float(0.5 * np.sqrt(0.75))], "up": [0, 1, 0]}
    channels, _ = render(program, tmp_path, scene, how, 256)
    expected = metal_albedo(0.8, alpha, 0.5)
    if alpha == 0.001:
        assert abs(expected - (0.8 + 0.2 * 0.5**5)) < 1e-4
    assert_mean(channels, expected, 1e-3)   # of the sky's table: its density is constant in a row


@pytest.mark.parametrize("how", ["preview", "path"])
def test_a_near_mirror_shows_lamp_and_sun_as_bright_as_they_are(program, tmp_path, how):
    """The image of a light in a mirror has its radiance times the reflectance."""
    mirror = {"metal": {"colour": 0.8, "roughness": 0.001}}
    lamp = {"type": "area", "position": [0, 1, -1.7320508], "target": [0, 0, 0], "size": [0.2, 0.2], "radiance": 5, "visible": True}
    scene = floor([lamp], material=mirror)
    scene["camera"] |= {"position": [0, 0.25, float(0.5 * np.sqrt(0.75))], "up": [0, 1, 0]}
    fresnel = 0.8 + 0.2 * 0.5**5
    assert_mean(render(program, tmp_path, scene, how, 256)[0], fresnel * 5, 1e-3)
    scene["lights"] = [{"type": "directional", "direction": [0, -1, 1.7320508], "irradiance": 4, "angular_diameter": 4}]
    assert_mean(render(program, tmp_path, scene, how, 256)[0], fresnel * 4 / (np.pi * np.sin(np.radians(2)) ** 2), 1e-3)


def test_light_and_bsdf_sampling_find_the_same_light_in_a_glossy_floor(program, tmp_path):
    """A lamp of 2 triangles is found both ways, one of 200 by light sampling alone: MIS on and off."""
    n = 10
    corners = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, n + 1), np.linspace(-0.5, 0.5, n + 1), indexing="ij"), -1).reshape(-1, 2)
    at = lambda i, j: i * (n + 1) + j + 1   # noqa: E731
    faces = [f"f {at(i, j)} {at(i + 1, j)} {at(i + 1, j + 1)} {at(i, j + 1)}" for i in range(n) for j in range(n)]
    (tmp_path / "lamp.obj").write_text("".join(f"v {x:g} {y:g} 0\n" for x, y in corners) + "\n".join(faces) + "\n")
    found = []
    for shape in ({"mesh": "lamp.obj"}, {"shape": "plane", "rotate": [90, 0, 0]}):
        scene = floor([], {**shape, "translate": [0, 0.6, -1], "emission": 3}, material={"metal": {"colour": 0.8, "roughness": 0.3}})
        scene["camera"] |= {"position": [0, 0.25, 0.43], "up": [0, 1, 0]}
        found.append(mean(render(program, tmp_path, scene, "direct", 512)[0]))
    (one, sigma_one), (two, sigma_two) = found
    assert max(sigma_one, sigma_two) < 0.01 * one and abs(one - two) < SIGMAS * np.hypot(sigma_one, sigma_two), found


TWO_WAYS = {
    "sky": {"type": "environment", "image": str(ROOT / "assets" / "lights" / "sky.exr")},
    "area": {"type": "area", "position": [0.5, 1.2, 0.8], "target": [0, 0.2, 0], "size": [0.8, 1.2], "radiance": [6, 5, 4]},
    "lamp": {"shape": "plane", "rotate": [150, 0, 20], "translate": [0.3, 1.2, 0.4], "emission": [6, 5, 4]},
}


@pytest.mark.parametrize("how", ["direct", "path"])
@pytest.mark.parametrize("light", TWO_WAYS)
def test_mis_on_and_off_have_the_same_mean(program, tmp_path, light, how):
    """Pixel by pixel, on matte, cloth, and metal whose lobe light sampling still finds."""
    cloth = {"shape": "sphere", "scale": 0.3, "translate": [-0.35, 0.3, 0], "fabric": str(ROOT / "assets" / "fabrics" / "satin.json"),
             "uv_scale": [0.2, 0.1]}
    metal = {"shape": "sphere", "scale": 0.3, "translate": [0.35, 0.3, 0], "metal": {"colour": 0.8, "roughness": 0.4}}
    shines = "emission" in TWO_WAYS[light]
    scene = {"camera": {"position": [0, 0.9, 2], "target": [0, 0.2, 0], "fov": 38}, "lights": [] if shines else [TWO_WAYS[light]],
             "objects": [{"shape": "plane", "scale": 3, "matte": {"albedo": 0.5}}, cloth, metal, *([TWO_WAYS[light]] if shines else [])]}
    pictures, sigmas, shadow_rays = [], [], []
    for seed, mis in enumerate(("on", "off")):
        channels, report = render(program, tmp_path, scene, how, 256, 48, "--mis", mis, "--seed", str(seed))
        assert report["mis"] is (mis == "on") and report["bad_samples"] == 0
        (tmp_path / "out.exr").rename(tmp_path / f"{mis}.exr")
        pictures.append([mean(channels, name)[0] for name in "RGB"])
        sigmas.append([mean(channels, name)[1] for name in "RGB"])
        shadow_rays.append(report["shadow_rays"])
    (on, off), sigma = np.array(pictures), np.hypot(*sigmas)
    assert (np.abs(on - off) < SIGMAS * sigma).all() and (sigma < 0.01 * on).all(), (on, off, sigma)
    done = subprocess.run([str(program("compare")), str(tmp_path / "on.exr"), str(tmp_path / "off.exr"), "--json", "--fail", "max_abs=inf"],
                          capture_output=True, text=True)
    found = json.loads(done.stdout)
    assert found["z_outliers"] < 0.01 and 0.8 < found["z_std"] < 1.2, found
    assert shadow_rays[0] > 1.01 * shadow_rays[1]


# ---- fabrics ------------------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("fabric", FABRICS, ids=lambda path: path.stem)
def test_no_fabric_is_brighter_than_the_furnace_that_it_is_in(program, tmp_path, fabric):
    """All bounces, both sides seen, gaps and light between fibres included."""
    scene = {"camera": {"position": [0, 0, 4.2], "target": [0, 0, 0], "fov": 30}, "lights": [{"type": "environment", "colour": 1}],
             "objects": [{"shape": "sphere", "fabric": str(fabric), "uv_scale": [0.2, 0.1]}]}
    channels, report = render(program, tmp_path, scene, "path", 32, 32)
    assert report["bad_samples"] == 0
    for name in "RGB":
        value, sigma = mean(channels, name)
        assert 0.02 < value < 1 + SIGMAS * sigma, (name, value, sigma)


# ---- lens ---------------------------------------------------------------------------------------------------------------------

LENS = {"camera": {"position": [0, 0, 3], "target": [0, 0, 0], "fov": 5, "lens_radius": 0.05, "focus_distance": 2},
        "objects": [{"shape": "sphere", "scale": 0.012, "emission": 1}]}


@pytest.mark.parametrize("how", ["preview", "direct"])
def test_a_point_out_of_focus_becomes_the_disc_of_the_thin_lens(program, tmp_path, how):
    """Seen at depth d with the focus at f, a point moves by offset (1 / f - 1 / d) on the plane at 1: a disc of radius R |1/f - 1/d|
    has the second moment of a quarter of its squared radius along x."""
    x = ((np.arange(64) + 0.5) / 32 - 1) * np.tan(np.radians(2.5))
    for focus in (2, 3):
        scene = {**LENS, "camera": LENS["camera"] | {"focus_distance": focus}}
        picture = render(program, tmp_path, scene, how, 256, 64)[0]["G"]
        # The ball's own disc and the pixel's width add their moments; in focus they are all.
        expected = (0.05 * (1 / focus - 1 / 3)) ** 2 / 4 + (0.012 / 3) ** 2 / 4 + (x[1] - x[0]) ** 2 / 12
        for axis in (0, 1):
            profile = picture.sum(axis) / picture.sum()
            middle = (profile * x).sum()
            spread = (profile * (x - middle) ** 2).sum()
            assert abs(spread / expected - 1) < 0.03 and abs(middle) < 2e-4, (focus, spread, expected, middle)


def test_the_f_number_is_focal_length_over_aperture(program, tmp_path):
    """A field of 53.13 degrees on a sensor 24 mm high is a focal length of 24 mm: at f/2, a radius of 6 mm."""
    fov = float(np.degrees(2 * np.arctan(0.5)))
    pictures = []
    for lens in ({"f_number": 2}, {"lens_radius": 0.006}, {"f_number": 4, "sensor_height": 0.048}):
        scene = {**LENS, "camera": {"position": [0, 0, 0.3], "target": [0, 0, 0], "fov": fov, "focus_distance": 0.05, **lens}}
        pictures.append(render(program, tmp_path, scene, "direct", 16, 64)[0]["G"])
    assert (pictures[0] > 0).sum() > 20
    assert np.allclose(pictures[0], pictures[1], atol=1e-3) and np.allclose(pictures[0], pictures[2], atol=1e-3)


def test_a_pinhole_keeps_its_bits_whatever_its_focus(program, tmp_path):
    pictures = []
    for lens in ({}, {"lens_radius": 0, "focus_distance": 2}):
        scene = {"camera": {"position": [0, 0, 3], "target": [0, 0, 0], "fov": 20, **lens}, "objects": [{"shape": "sphere", "scale": 0.4}],
                 "lights": [{"type": "environment"}]}
        pictures.append(render(program, tmp_path, scene, "path", 4)[0])
    assert all((pictures[0][name] == pictures[1][name]).all() for name in pictures[0])


def test_preview_and_reference_agree_on_lens_metal_and_emitters(program, tmp_path):
    """Cloth, chrome and a lamp, all of it partly out of focus."""
    scene = {"camera": {"position": [0, 0.25, 0.9], "target": [0, 0.06, 0], "fov": 22, "lens_radius": 0.02, "focus_distance": 0.8},
             "lights": [{"type": "environment", "colour": [0.2, 0.25, 0.3]},
                        {"type": "area", "position": [0.1, 0.3, -0.2], "target": [0, 0, 0], "size": [0.1, 0.1], "radiance": 20, "visible": True}],
             "objects": [{"shape": "plane", "fabric": str(ROOT / "assets" / "fabrics" / "polyester_satin.json")},
                         {"shape": "sphere", "scale": 0.06, "translate": [-0.06, 0.06, 0], "metal": {"roughness": 0.05}},
                         {"shape": "sphere", "scale": 0.03, "translate": [0.08, 0.03, 0.1], "metal": {"colour": [0.9, 0.6, 0.3], "roughness": 0.3}},
                         {"shape": "sphere", "scale": 0.01, "translate": [0, 0.012, 0.15], "emission": [4, 2, 1]}]}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    test_equality.assert_equal(test_equality.compare_renderers(program, tmp_path, tmp_path / "scene.json", 512, size=64))


REFUSED = {
    "two materials": ({"objects": [{"shape": "plane", "matte": {}, "metal": {}}]}, 'objects.0.metal: found both "matte" and "metal"'),
    "a cloth that shines": ({"objects": [{"shape": "plane", "fabric": "a.json", "emission": 1}]}, "objects.0.emission: found a fabric that shines"),
    "roughness": ({"objects": [{"shape": "plane", "metal": {"roughness": 0}}]}, "objects.0.metal.roughness: found 0"),
    "negative emission": ({"objects": [{"shape": "plane", "emission": -1}]}, "objects.0.emission: found -1"),
    "two lenses": ({"camera": {"lens_radius": 0.1, "f_number": 2}}, 'camera.f_number: found both "f_number" and "lens_radius"'),
    "a sensor alone": ({"camera": {"sensor_height": 0.1}}, 'camera.sensor_height: found no "f_number" beside it'),
    "an f-number of 0": ({"camera": {"f_number": 0}}, "camera.f_number: found 0"),
    "a key of another light": ({"lights": [{"type": "point", "position": [0, 1, 0], "intensity": 1, "visible": True}]}, 'unknown key "visible"'),
}


@pytest.mark.parametrize("scene, words", REFUSED.values(), ids=REFUSED.keys())
def test_what_cannot_be_is_told_by_file_line_and_key(program, tmp_path, scene, words):
    (tmp_path / "scene.json").write_text(json.dumps(scene, indent=1))
    done = subprocess.run([program("render"), tmp_path / "scene.json", "-o", tmp_path / "out.exr"], capture_output=True, text=True)
    assert done.returncode == 1 and words in done.stderr and "scene.json:" in done.stderr and done.stderr.count("\n") == 1, done.stderr


def test_metal_samples_follow_their_density(build, evaluator):
    """Chi-square, from a mirror-like lobe to the roughest, at a steep and at a grazing view."""
    for seed, (alpha, o) in enumerate([(0.1, test_sampling.VIEWS[0]), (0.3, test_sampling.VIEWS[1]), (1.0, test_sampling.VIEWS[2])]):
        u = test_sampling.stratified(np.random.default_rng(seed), test_sampling.SAMPLES)
        rows = evaluator.run(build, "metal_sample", np.c_[test_sampling.tile(np.r_[alpha, o], len(u)), u])
        # What goes below the surface has no sample: its share is missing from the density, too.
        directions = rows[rows[:, 3] > 0, :3]
        def density(i):
            return oracle.metal_pdf(np.full(i.shape[:-1], alpha), i, np.broadcast_to(o, i.shape)) * len(u) / len(directions)
        p, mass = test_sampling.chi_square(directions, density, sub=16)
        assert abs(mass * len(directions) / len(u) - len(directions) / len(u)) < 5e-3
        assert p > test_sampling.SIGNIFICANCE, f"alpha {alpha}: p = {p:.2g}"


def test_metal_is_reciprocal(build, evaluator):
    rng = np.random.default_rng(8)
    i, o = (np.abs(oracle.unit(rng.normal(size=(2000, 3)))) for _ in range(2))
    alpha, colour = rng.uniform(0.05, 1, (2000, 1)), rng.random((2000, 3))
    there = evaluator.run(build, "metal_value", np.c_[colour, alpha, i, o]) / i[:, 2:]
    back = evaluator.run(build, "metal_value", np.c_[colour, alpha, o, i]) / o[:, 2:]
    assert np.allclose(there, back, rtol=1e-9 if build == "f64" else 2e-3)
