"""Our scene JSON as a Mitsuba 3 scene: what the tests and the benchmark against an independent renderer read.

Typed from the scene's schema and docs/math.md, not from glsl/ or reference/. Meshes are read by Mitsuba's own readers, spheres and
planes are its own shapes. Lights that Mitsuba lacks are made of what it has: a sun is a far disk, a phone's flash a millimetre of
Lambertian emitter, the fading rim of a spot a projected texture. What cannot be said in Mitsuba's terms is refused (ValueError)."""
import glob
import os
import pathlib
import re

import numpy as np
import OpenEXR

# Far enough that 2 m of scene see the same disk to 1e-3 of its diameter, near enough for float positions on it.
SUN_DISTANCE_M = 2e3
# A square emitter of this side is a point with a cosine lobe to (side / distance)^2.
FLASH_SIDE_M = 1e-3
SPOT_TEXELS = 1024   # across the cone; bilinear, the smooth step is off by 1e-5
BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}


def use(variant):
    """The mitsuba module with the variant chosen. For llvm_ad_rgb the newest libLLVM of the machine: 16 cannot compile its kernels."""
    if variant.startswith("llvm"):
        found = [(tuple(map(int, re.findall(r"\d+", path.rsplit("/", 1)[1]))), path) for path in glob.glob("/usr/lib/*/libLLVM[.-]*so*")
                 if re.search(r"\d", path.rsplit("/", 1)[1])]
        if not found:
            raise RuntimeError("no libLLVM in /usr/lib: ./dev installs one")
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", max(found)[1])
    import mitsuba
    mitsuba.set_variant(variant)
    return mitsuba


def rgb(value):
    return np.broadcast_to(np.asarray(value, float), (3,)).copy()


def spectrum(value):
    return {"type": "rgb", "value": rgb(value).tolist()}


def unit(v):
    v = np.asarray(v, float)
    return v / np.linalg.norm(v)


def facing(mi, position, target, scale=(1, 1, 1)):
    """Transform of a shape in the xy plane: to `position`, its +z toward `target`, its x level and its y upward, as our area lights."""
    axis = unit(np.subtract(target, position))
    up = np.array([0, 1, 0]) if abs(axis[1]) < .999 else np.array([0, 0, -1])
    x = unit(np.cross(up, axis))
    y = np.cross(axis, x)
    matrix = np.eye(4)
    matrix[:3] = np.stack([x * scale[0], y * scale[1], axis * scale[2], np.asarray(position, float)], 1)
    return mi.ScalarTransform4f(matrix)


# ---- lights ------------------------------------------------------------------------------------------------------------------------

def environment_nodes(image):
    """Both renderers interpolate between texel centres in u; in v we do, clamped at the poles, and Mitsuba has its rows at j / (H - 1).
    With rows at every centre and half way between, both are the same piecewise bilinear function. Ours begins half a turn from theirs.

    image (h, w, 3), row 0 at the top, w even -> (2 h + 1, w, 3)"""
    h, w, _ = image.shape
    if w % 2:
        raise ValueError(f"an environment {w} texels wide, expected an even number")
    nodes = np.empty((2 * h + 1, w, 3), np.float32)
    nodes[1::2] = image
    nodes[2:-1:2] = (image[1:] + image[:-1]) / 2
    nodes[0], nodes[-1] = image[0], image[-1]
    return np.roll(nodes, w // 2, 1)


def environment(mi, light, folder):
    scale = rgb(light.get("scale", 1))
    if "image" not in light:
        return {"type": "constant", "radiance": spectrum(scale * rgb(light.get("colour", 1)))}
    bitmap = mi.Bitmap(str(folder / light["image"])).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    nodes = environment_nodes(np.array(bitmap) * scale.astype(np.float32))
    return {"type": "envmap", "bitmap": mi.Bitmap(nodes), "to_world": mi.ScalarTransform4f().rotate([0, 1, 0], light.get("rotation", 0.0))}


def sun(mi, light):
    toward = -unit(light["direction"])
    half = np.radians(light.get("angular_diameter", .53)) / 2
    if half <= 0:
        return {"type": "directional", "direction": (-toward).tolist(), "irradiance": spectrum(light["irradiance"])}
    radius = SUN_DISTANCE_M * np.tan(half)
    emitter = {"type": "area", "radiance": spectrum(rgb(light["irradiance"]) / (np.pi * np.sin(half) ** 2))}
    return {"type": "disk", "to_world": facing(mi, toward * SUN_DISTANCE_M, [0, 0, 0], (radius, radius, 1)), "emitter": emitter, "bsdf": BLACK}


def spot(mi, light):
    """A cone of constant intensity times a texture: the smooth step of the cosine between the rim and the penumbra's inner edge."""
    cone = light.get("cone", 30.0)
    penumbra = light.get("penumbra", .1 * cone)
    if cone >= 80:
        raise ValueError(f"a spot of {cone} degrees from the axis to its rim: a projected texture reaches 80")
    result = {"type": "spot", "intensity": spectrum(light["intensity"]), "cutoff_angle": cone, "beam_width": cone * (1 - 1e-5),
              "to_world": mi.ScalarTransform4f().look_at(light["position"], light["target"], [0.31, 0.9, 0.2])}
    if penumbra > 0:
        x = ((np.arange(SPOT_TEXELS) + .5) / SPOT_TEXELS * 2 - 1) * np.tan(np.radians(cone))
        cosine = 1 / np.sqrt(1 + x[:, None] ** 2 + x[None, :] ** 2)
        low, high = np.cos(np.radians(cone)), np.cos(np.radians(cone - penumbra))
        step = np.clip((cosine - low) / (high - low), 0, 1)
        lobe = (step * step * (3 - 2 * step)).astype(np.float32)
        result["texture"] = {"type": "bitmap", "bitmap": mi.Bitmap(np.repeat(lobe[..., None], 3, -1)), "raw": True, "filter_type": "bilinear"}
    return result


def rectangle(mi, light, size, radiance):
    return {"type": "rectangle", "to_world": facing(mi, light["position"], light["target"], (size[0] / 2, size[1] / 2, 1)),
            "emitter": {"type": "area", "radiance": spectrum(radiance)}, "bsdf": BLACK}


def light_of(mi, light, folder):
    kind = light["type"]
    if kind == "environment":
        return environment(mi, light, folder)
    if kind == "directional":
        return sun(mi, light)
    if kind == "point":
        return {"type": "point", "position": light["position"], "intensity": spectrum(light["intensity"])}
    if kind == "spot":
        return spot(mi, light)
    if kind == "area":
        return rectangle(mi, light, np.broadcast_to(light["size"], 2), light["radiance"])
    if kind == "flash":
        return rectangle(mi, light, (FLASH_SIDE_M, FLASH_SIDE_M), rgb(light["intensity"]) / FLASH_SIDE_M ** 2)
    raise ValueError(f"a light of type {kind}")


# ---- objects, camera ---------------------------------------------------------------------------------------------------------------

def placed(mi, entry):
    """Scale, then turn about x, y, z, then move."""
    transform = mi.ScalarTransform4f().translate(entry.get("translate", [0, 0, 0]))
    x, y, z = entry.get("rotate", [0, 0, 0])
    for axis, angle in (([0, 0, 1], z), ([0, 1, 0], y), ([1, 0, 0], x)):
        transform = transform @ mi.ScalarTransform4f().rotate(axis, angle)
    return transform @ mi.ScalarTransform4f().scale(rgb(entry.get("scale", 1)).tolist())


def shape_of(mi, entry, folder, assets):
    unknown = set(entry) - {"mesh", "shape", "translate", "rotate", "scale", "fabric", "matte", "uv_scale"}
    if unknown:
        raise ValueError(f"an object with {sorted(unknown)}")
    transform = placed(mi, entry)
    # Our shapes stand upright (y), Mitsuba's sphere has its poles on z and its rectangle lies in xy; both with u and v as ours.
    upright = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    kind = entry.get("shape")
    if kind == "sphere":
        return {"type": "sphere", "to_world": transform @ upright}
    if kind == "plane":
        return {"type": "rectangle", "to_world": transform @ upright @ mi.ScalarTransform4f().scale(.5)}
    if kind in ("drape", "curtain"):
        return {"type": "ply", "filename": str(assets / "meshes" / f"{kind}.ply"), "to_world": transform}
    if kind is None:
        path = folder / entry["mesh"]
        return {"type": path.suffix[1:], "filename": str(path), "to_world": transform}
    raise ValueError(f"a shape called {kind}")


def sensor_of(mi, scene):
    camera = {"position": [0, 0, 1], "target": [0, 0, 0], "up": [0, 1, 0], "fov": 40} | scene.get("camera", {})
    film = {"resolution": [256, 256], "filter": "box"} | scene.get("film", {})
    width, height = film["resolution"]
    distance = float(np.linalg.norm(np.subtract(camera["target"], camera["position"])))
    if film["filter"] != "box":
        raise ValueError(f"a pixel filter {film['filter']}: Mitsuba's film reads filters from a table of 32 steps, which is not exact enough")
    return {"type": "perspective", "fov_axis": "y", "fov": camera["fov"], "near_clip": 1e-3 * distance, "far_clip": 1e5 * distance,
            "to_world": mi.ScalarTransform4f().look_at(camera["position"], camera["target"], camera["up"]),
            "film": {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb", "component_format": "float32",
                     "rfilter": {"type": "box"}}}


def translate(mi, scene, folder, assets, depth, cloth=None):
    """The scene as a dict for mi.load_dict.

    scene   our JSON, as an object;  folder  what its paths are relative to;  assets  our assets/
    depth   surfaces along a path, as --max-depth: 1 is direct light
    cloth   function of an object's JSON -> a Mitsuba BSDF, for objects with a fabric

    Area lights, suns and flashes are surfaces to Mitsuba, which bar the way: they belong where no ray has business behind them."""
    lights = scene.get("lights", [])
    background = any(light["type"] == "environment" and light.get("visible", True) for light in lights)
    # One more than ours: they count the light's own vertex.
    result = {"type": "scene", "sensor": sensor_of(mi, scene),
              "integrator": {"type": "path", "max_depth": depth + 1, "hide_emitters": not background}}
    for k, light in enumerate(lights):
        result[f"light_{k}"] = light_of(mi, light, pathlib.Path(folder))
    for k, entry in enumerate(scene["objects"]):
        shape = shape_of(mi, entry, pathlib.Path(folder), pathlib.Path(assets))
        if "fabric" in entry:
            shape["bsdf"] = cloth(entry)
        else:
            albedo = entry.get("matte", {}).get("albedo", .18)
            shape["bsdf"] = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": spectrum(albedo)}}
        result[f"object_{k}"] = shape
    return result


def render(mi, loaded, spp, runs, seed=0):
    """`runs` pictures of their own random numbers, (runs, rows, columns, 3) float64: their mean and spread give value and variance."""
    return np.stack([np.array(mi.render(loaded, spp=spp, seed=seed + k), dtype=np.float64) for k in range(runs)])


def write_picture(path, pictures):
    """EXR of the mean of (runs, rows, columns, 3) pictures, and the variance of that mean in variance.R, .G, .B: what selvedge-compare
    reads. One picture alone has no variance layer."""
    channels = {"RGB": pictures.mean(0).astype("f4")}
    if len(pictures) > 1:
        variance = pictures.var(0, ddof=1) / len(pictures)
        channels |= {f"variance.{letter}": np.ascontiguousarray(variance[..., c], "f4") for c, letter in enumerate("RGB")}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))


def write_ball(path, around, up):
    """PLY of a unit sphere of latitude-longitude facets with smooth normals: the same triangles for both renderers.

    around, up  facets about y and from pole to pole"""
    phi, theta = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(up + 1) * np.pi / up)
    p = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), np.cos(phi) * np.sin(theta)], -1).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(up), np.arange(around), indexing="ij")
    a, b = row * around + column, row * around + (column + 1) % around
    upper, lower = np.stack([a, a + around, b + around], -1)[:-1], np.stack([a, b + around, b], -1)[1:]   # the poles' rows have one each
    faces = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    header = "ply\nformat binary_little_endian 1.0\n" + f"element vertex {len(p)}\n"
    header += "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.zeros(len(faces), [("count", "u1"), ("indices", "<i4", 3)])
    rows["count"], rows["indices"] = 3, faces
    path.write_bytes(header.encode() + np.tile(p, 2).astype("<f4").tobytes() + rows.tobytes())
