"""The cloth BSDF as a Mitsuba 3 plugin: the ply-level model without visibility ("micro") of docs/math.md 2 to 4 and 6, typed from there
and not from glsl/, vectorised with Dr.Jit. Sections of math.md in brackets.

Points of the cloth come from maps.exr of `selvedge-bake -o`, the yarns' numbers from the fabric's JSON, which has to state them all
(`diffuse` and `diffuse_transmission` too: what follows from the albedo where they are missing is not this file's business)."""
import functools
import json
import operator
import pathlib

import numpy as np
import OpenEXR

YARNS = ("warp", "weft")
REPEAT = "repeat"   # a footprint: every point of the cloth is as likely as any other


class Fabric:
    """Maps and yarns. front, back: {layer: (rows, columns)}, row 0 at v = 0; tile [m]; yarns: {number: (2, ...)}, warp and weft."""

    def __init__(self, fabric, baked):
        """fabric: the JSON object; baked: the folder that selvedge-bake wrote."""
        report = json.loads((pathlib.Path(baked) / "fabric.json").read_text())
        if report["yarns"] != list(YARNS):
            raise ValueError(f"found yarns {report['yarns']}, expected {YARNS}: a woven fabric without draft colours")
        self.tile = np.array(report["tile"])
        with OpenEXR.File(str(pathlib.Path(baked) / "maps.exr"), separate_channels=True) as file:
            maps = {name: np.array(channel.pixels)[::-1].astype(np.float32) for name, channel in file.channels().items()}
        self.sides = [{layer: maps[f"{side}.{layer}"] for layer in ("slope.x", "slope.y", "azimuth", "yarn", "gap")} for side in ("front", "back")]
        both = [fabric[name] for name in YARNS]

        def numbers(key, fallback=None):
            return np.array([np.broadcast_to(np.asarray(yarn[key] if key in yarn or fallback is None else yarn[fallback], np.float32), (3,))
                             for yarn in both])

        self.yarns = {"albedo_r": numbers("albedo"), "albedo_t": numbers("albedo_transmission", "albedo"), "diffuse_r": numbers("diffuse"),
                      "diffuse_t": numbers("diffuse_transmission"), "alpha_r": numbers("roughness")[:, 0],
                      "alpha_t": numbers("roughness_transmission", "roughness")[:, 0], "thickness": numbers("thickness")[:, 0],
                      "twist": np.radians(numbers("fibre_twist")[:, 0]), "mix": numbers("diffuse_mix")[:, 0]}


def plugin(mi):
    """The class Cloth for the variant that is set."""
    import drjit as dr

    def mirror(w):
        return mi.Vector3f(w.x, w.y, -w.z)

    def squared(x):
        return x * x

    # ---- [2.2], [2.4]: SGGX of a fibre ----

    def sggx_sigma(w, t, alpha):
        return dr.sqrt(dr.squared_norm(dr.cross(w, t)) + squared(alpha * dr.dot(w, t)))

    def sggx_d_half(i, o, t, alpha):
        h = i + o
        h2 = dr.squared_norm(h)
        antiparallel = h2 < 1e-8
        c2, s2 = squared(dr.dot(h, t)), dr.squared_norm(dr.cross(h, t))
        q = squared(alpha) * h2 / (squared(alpha) * s2 + c2)
        sigma = sggx_sigma(o, t, alpha)
        mean = (squared(sigma) + squared(alpha)) / (2 * dr.pi * sigma * squared(sigma))
        return dr.select(antiparallel, mean, squared(q) / (dr.pi * alpha))

    def sample_flake(o, t, alpha, u):
        """A normal of the distribution D_w of what is seen along o, by the stretched cosine hemisphere [2.3]."""
        fibre = mi.Frame3f(t)
        seen = fibre.to_local(o)
        stretched = mi.Frame3f(dr.normalize(mi.Vector3f(seen.x, seen.y, alpha * seen.z)))
        m = stretched.to_world(mi.warp.square_to_cosine_hemisphere(u))
        return fibre.to_world(dr.normalize(mi.Vector3f(m.x, m.y, alpha * m.z)))

    # ---- [3.4]: the slab, K = f c_i c_o for albedo 1 ----

    def phi1(x):
        series = 1 - x / 2 * (1 - x / 3 * (1 - x / 4 * (1 - x / 5)))
        return dr.select(x < .1, series, (1 - dr.exp(-x)) / dr.maximum(x, .1))

    def depths(i, o, c_i, c_o, t, alpha, thickness):
        return (thickness * sggx_sigma(i, t, alpha) / dr.maximum(c_i, 1e-6), thickness * sggx_sigma(o, t, alpha) / dr.maximum(c_o, 1e-6))

    def slab_reflect(i, o, c_i, c_o, t, alpha, thickness):
        """D T phi1(T(Li + Lo)) / 4."""
        depth_i, depth_o = depths(i, o, c_i, c_o, t, alpha, thickness)
        return sggx_d_half(i, o, t, alpha) * thickness * phi1(depth_i + depth_o) / 4

    def slab_transmit(i, o, c_i, c_o, t, alpha, thickness):
        """D T e^{-T min(Li, Lo)} phi1(T |Li - Lo|) / 4."""
        depth_i, depth_o = depths(i, o, c_i, c_o, t, alpha, thickness)
        return sggx_d_half(i, o, t, alpha) * thickness * dr.exp(-dr.minimum(depth_i, depth_o)) * phi1(dr.abs(depth_i - depth_o)) / 4

    class Point:
        """A point of the cloth, in the frame of the viewer's side."""

    class Cloth(mi.BSDF):
        def __init__(self, fabric, uv_scale, footprint):
            """uv_scale: metres to one unit of UV, along u and v. footprint: side in metres of the square about the hit in which the point is
            drawn, or REPEAT."""
            mi.BSDF.__init__(self, mi.Properties())
            sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.has_gaps = bool(fabric.sides[0]["gap"].any())
            kinds = [mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.GlossyTransmission] + [mi.BSDFFlags.Null] * self.has_gaps
            self.m_components = [kind | sides for kind in kinds]
            self.m_flags = functools.reduce(operator.or_, self.m_components)
            self.rows, self.columns = fabric.sides[0]["gap"].shape
            self.tiles = mi.Vector2f(*(np.broadcast_to(uv_scale, 2) / fabric.tile).tolist())
            self.footprint = mi.Vector2f(*([1.0, 1.0] if footprint == REPEAT else (footprint / fabric.tile).tolist()))
            self.maps = [{name: mi.Float(values.ravel()) for name, values in side.items()} for side in fabric.sides]
            self.yarns = {name: (mi.Color3f(*(mi.Float(values[:, c]) for c in range(3))) if values.ndim == 2 else mi.Float(values))
                          for name, values in fabric.yarns.items()}
            dr.make_opaque(self.tiles, self.footprint)

        def texel(self, si):
            """Index of the texel at a random place of the footprint, smoothed by up to half a texel each way. The place is a hash of the hit,
            so that sample, eval and pdf at one hit speak of one point [6.5]."""
            a, b = mi.sample_tea_32(dr.reinterpret_array(mi.UInt32, si.uv.x), dr.reinterpret_array(mi.UInt32, si.uv.y))
            c, d = mi.sample_tea_32(a, b + 1)
            uniform = [mi.Float(k >> 8) * 2 ** -24 - .5 for k in (a, b, c, d)]
            where = si.uv * self.tiles + self.footprint * mi.Vector2f(uniform[0], uniform[1])
            x = where.x * self.columns + uniform[2]
            y = where.y * self.rows + uniform[3]
            x -= dr.floor(x / self.columns) * self.columns
            y -= dr.floor(y / self.rows) * self.rows
            return dr.minimum(mi.UInt32(y), self.rows - 1) * self.columns + dr.minimum(mi.UInt32(x), self.columns - 1)

        def point(self, si, active):
            """The point at a hit, with o toward the viewer and whether the front is seen [1]."""
            index = self.texel(si)

            def fetch(name):
                return [dr.gather(mi.Float, side[name], index, active) for side in self.maps]

            p = Point()
            # The side is the one that the geometry shows; where the shading normal says otherwise nothing is seen.
            toward = si.to_world(si.wi)
            p.front = dr.dot(si.n, toward) > 0
            p.o = dr.select(p.front, si.wi, mirror(si.wi))
            p.seen = active & (p.o.z > 0)

            def viewers(name):
                front, back = fetch(name)
                return dr.select(p.front, front, back), dr.select(p.front, back, front)

            (fx, bx), (fy, by) = viewers("slope.x"), viewers("slope.y")
            p.length_f, p.length_b = dr.sqrt(1 + fx * fx + fy * fy), dr.sqrt(1 + bx * bx + by * by)
            p.n_f, p.n_b = mi.Vector3f(-fx, -fy, 1) / p.length_f, mi.Vector3f(-bx, -by, 1) / p.length_b
            p.gap = viewers("gap")[0] > .5 if self.has_gaps else mi.Bool(False)
            yarn = mi.UInt32(viewers("yarn")[0] + .5)
            for name, table in self.yarns.items():
                kind = mi.Color3f if isinstance(table, mi.Color3f) else mi.Float
                setattr(p, name, dr.gather(kind, table, yarn, active) if kind is mi.Float else
                        mi.Color3f(*(dr.gather(mi.Float, table[c], yarn, active) for c in range(3))))
            # The ply's way in the plane, lifted onto the surface; the fibre is turned by the twist, whose sense the mirror turns round.
            azimuth = viewers("azimuth")[0]
            cx, cy = dr.cos(azimuth), dr.sin(azimuth)
            t_p = dr.normalize(mi.Vector3f(cx, cy, fx * cx + fy * cy))
            twist = dr.select(p.front, p.twist, -p.twist)
            p.t = dr.normalize(dr.cos(twist) * t_p + dr.sin(twist) * dr.cross(p.n_f, t_p))
            return p

        def value(self, p, i):
            """F with its cosine: K_r / c_o + F_rd above, |N_b| / |N_f| K_t / c_o + F_td below [6.4.1, 4.1]."""
            above = i.z > 0
            i_side = dr.select(above, i, mirror(i))
            n = dr.select(above, p.n_f, p.n_b)
            c_i, c_o = dr.maximum(dr.dot(n, i_side), 0), dr.dot(p.n_f, p.o)
            reflected = slab_reflect(i, p.o, c_i, c_o, p.t, p.alpha_r, p.thickness) * p.albedo_r
            transmitted = slab_transmit(i, p.o, c_i, c_o, p.t, p.alpha_t, p.thickness) * p.albedo_t * (p.length_b / p.length_f)
            slab = dr.select(c_i > 0, dr.select(above, reflected, transmitted) / dr.maximum(c_o, 1e-6), 0)
            diffuse = dr.select(above, p.diffuse_r, p.diffuse_t) * ((p.mix * c_i + (1 - p.mix) * i_side.z) / dr.pi)
            return dr.select((c_o > 0) & (i.z != 0), slab + diffuse, 0)

        def lobes(self, p):
            """Probabilities: flakes of alpha_r, flakes of alpha_t, diffuse about +n_s, about -n_s [6.5]. A tenth each at least: the diffuse
            ones are about n_s, and have to find what is about n_p too."""
            weights = [mi.luminance(c) for c in (p.albedo_r, p.albedo_t, p.diffuse_r, p.diffuse_t)]
            total = dr.maximum(weights[0] + weights[1] + weights[2] + weights[3], 1e-6)
            return [.1 + .6 * w / total for w in weights]

        def density(self, p, i):
            weights = self.lobes(p)
            flakes = sum(w * sggx_d_half(i, p.o, p.t, alpha) / (4 * sggx_sigma(p.o, p.t, alpha))
                         for w, alpha in zip(weights, (p.alpha_r, p.alpha_t)))
            return flakes + dr.select(i.z > 0, weights[2], weights[3]) * dr.abs(i.z) / dr.pi

        def agrees(self, si, p, i_local):
            """Shading and geometric normal put the light on the same side [10, hazard 23]."""
            return (dr.dot(si.n, si.to_world(i_local)) > 0) == (i_local.z > 0)

        def eval_pdf(self, ctx, si, wo, active=True):
            p = self.point(si, active)
            i = dr.select(p.front, wo, mirror(wo))
            good = p.seen & ~p.gap & self.agrees(si, p, wo)
            return dr.select(good, self.value(p, i), 0), dr.select(good, self.density(p, i), 0)

        def eval(self, ctx, si, wo, active=True):
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx, si, wo, active=True):
            return self.eval_pdf(ctx, si, wo, active)[1]

        def sample_at(self, p, si, sample1, sample2):
            weights = self.lobes(p)
            flake = sample1 < weights[0] + weights[1]
            m = sample_flake(p.o, p.t, dr.select(sample1 < weights[0], p.alpha_r, p.alpha_t), sample2)
            cosine = mi.warp.square_to_cosine_hemisphere(sample2)
            lambert = dr.select(sample1 < weights[0] + weights[1] + weights[2], cosine, mirror(cosine))
            i = dr.normalize(dr.select(flake, 2 * dr.dot(p.o, m) * m - p.o, lambert))
            wo = dr.select(p.front, i, mirror(i))
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = dr.select(p.gap, -si.wi, wo)
            bs.pdf = dr.select(p.gap, 1, self.density(p, i))
            bs.eta = 1
            bs.sampled_type = dr.select(p.gap, mi.UInt32(+mi.BSDFFlags.Null), mi.UInt32(+mi.BSDFFlags.GlossyReflection))
            bs.sampled_component = dr.select(p.gap, mi.UInt32(2), mi.UInt32(0))
            good = p.seen & (p.gap | (self.agrees(si, p, wo) & (bs.pdf > 0)))
            weight = dr.select(p.gap, mi.Color3f(1), self.value(p, i) / dr.maximum(bs.pdf, 1e-12))
            bs.pdf = dr.select(good, bs.pdf, 0)
            return bs, dr.select(good, weight, 0)

        def sample(self, ctx, si, sample1, sample2, active=True):
            return self.sample_at(self.point(si, active), si, sample1, sample2)

        def eval_pdf_sample(self, ctx, si, wo, sample1, sample2, active=True):
            p = self.point(si, active)
            i = dr.select(p.front, wo, mirror(wo))
            good = p.seen & ~p.gap & self.agrees(si, p, wo)
            return (dr.select(good, self.value(p, i), 0), dr.select(good, self.density(p, i), 0),
                    *self.sample_at(p, si, sample1, sample2))

        def eval_null_transmission(self, si, active=True):
            index = self.texel(si)
            gap = dr.gather(mi.Float, self.maps[0]["gap"], index, active) > .5
            return dr.select(gap & active, mi.Color3f(1), mi.Color3f(0))

    return Cloth
