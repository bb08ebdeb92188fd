"""The mathematics once more, in numpy float64: typed from math.md (sections in brackets) and the file formats' descriptions, not
from glsl/, with which it shares no code. Definitions are preferred over the stable forms: SGGX is its matrix here, slabs are
expm1. Vectors are the last axis; directions are made unit here, since that is what they mean."""
import numpy as np

PI = np.pi
ALPHA_MIN = 0.01
COSINE_MIN = 1e-6
DEPTH_MAX = 80.0


def dot(a, b):
    return np.sum(a * b, axis=-1)


def unit(v):
    return v / np.sqrt(dot(v, v))[..., None]


def luminance(c):
    return c @ np.array([0.2126, 0.7152, 0.0722])


# ---- frames ------------------------------------------------------------------------------------------------------------------

def frame(n):
    """Rows x, y, z. Duff et al. 2017: x = (1 + s n_x^2 a, s b, -s n_x), y = (b, s + n_y^2 a, -n_y), a = -1/(s + n_z), b = n_x n_y a."""
    s = np.where(n[..., 2] >= 0, 1.0, -1.0)
    a = -1 / (s + n[..., 2])
    b = n[..., 0] * n[..., 1] * a
    x = np.stack([1 + s * n[..., 0] ** 2 * a, s * b, -s * n[..., 0]], -1)
    y = np.stack([b, s + n[..., 1] ** 2 * a, -n[..., 1]], -1)
    return np.stack([x, y, n], -2)


def to_world(f, w):
    return np.einsum("...i,...ij->...j", w, f)


def to_local(f, w):
    return np.einsum("...ij,...j->...i", f, w)


# ---- SGGX [2] ----------------------------------------------------------------------------------------------------------------

def sggx_sigma(w, t, alpha):
    """sqrt(w^T S w), S = I - (1 - alpha^2) t t^T [2.1]. Written as |w|^2 - c^2 + alpha^2 c^2 with |w|^2 - c^2 from the angle
    that the difference vector gives: near t the matrix loses digits even in float64."""
    w, t = unit(w), unit(t)
    c = dot(w, t)
    near = w - np.sign(c)[..., None] * t        # |near| = 2 sin(angle / 2)
    half = 0.5 * np.sqrt(dot(near, near))
    sine2 = 4 * half**2 * (1 - half**2)
    return np.sqrt(np.where(np.abs(c) > 0.5, sine2, 1 - c * c) + alpha**2 * c * c)


def sggx_d(h, t, alpha):
    """1 / (pi sqrt(det S) (h^T S^-1 h)^2), det S = alpha^2, S^-1 = I + (1/alpha^2 - 1) t t^T [2.1]."""
    h, t = unit(h), unit(t)
    return 1 / (PI * alpha * (1 + (1 / alpha**2 - 1) * dot(h, t) ** 2) ** 2)


def sggx_d_antiparallel(o, t, alpha):
    """(sigma^2 + alpha^2) / (2 pi sigma^3) [2.4]."""
    sigma = sggx_sigma(o, t, alpha)
    return (sigma**2 + alpha**2) / (2 * PI * sigma**3)


def sggx_d_half(i, o, t, alpha):
    h = i + o
    far = dot(h, h) >= 1e-8
    return np.where(far, sggx_d(np.where(far[..., None], h, [0.0, 0.0, 1.0]), t, alpha), sggx_d_antiparallel(o, t, alpha))


def sggx_d_w(w, h, t, alpha):
    return np.maximum(0, dot(w, h)) * sggx_d(h, t, alpha) / sggx_sigma(w, t, alpha)


def cosine_direction(u):
    r, phi = np.sqrt(u[..., 0]), 2 * PI * u[..., 1]
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u[..., 0])], -1)


def stretch(v, alpha):
    return unit(np.concatenate([v[..., :2], (alpha * v[..., 2])[..., None]], -1))


def sggx_sample_vndf(w, t, alpha, u):
    """[2.3]: stretch w, cosine hemisphere about it, stretch back."""
    fibre = frame(unit(t))
    m = to_world(frame(stretch(to_local(fibre, unit(w)), alpha)), cosine_direction(u))
    return to_world(fibre, stretch(m, alpha))


# ---- slab [3] ----------------------------------------------------------------------------------------------------------------

def phi1(x):
    return np.where(x > 0, -np.expm1(-x) / np.where(x > 0, x, 1), 1.0)


def optical_depths(sigma_i, sigma_o, c_i, c_o, thickness):
    return thickness * sigma_i / np.maximum(c_i, COSINE_MIN), thickness * sigma_o / np.maximum(c_o, COSINE_MIN)


def slab_reflect(d, sigma_i, sigma_o, c_i, c_o, thickness):
    """K_r = (D/4) c_i c_o / (sigma_i c_o + sigma_o c_i) (1 - e^{-T(sigma_i/c_i + sigma_o/c_o)}) [3.4]."""
    d_i, d_o = optical_depths(sigma_i, sigma_o, c_i, c_o, thickness)
    bottom = sigma_i * c_o + sigma_o * c_i
    safe = np.where(bottom > 0, bottom, 1)
    return np.where(bottom > 0, 0.25 * d * c_i * c_o / safe * -np.expm1(-np.minimum(d_i + d_o, DEPTH_MAX)), 0)


def slab_transmit(d, sigma_i, sigma_o, c_i, c_o, thickness):
    """K_t = (D/4) T e^{-T min(Li, Lo)} phi1(T |Li - Lo|) [3.4]."""
    d_i, d_o = optical_depths(sigma_i, sigma_o, c_i, c_o, thickness)
    return 0.25 * d * thickness * np.exp(-np.minimum(np.minimum(d_i, d_o), DEPTH_MAX)) * phi1(np.abs(d_i - d_o))


def unscattered(sigma_o, c_o, thickness):
    """U = e^{-T Lo} [3.1]."""
    return np.exp(-thickness * sigma_o / c_o)


# ---- the point [4, 6] -----------------------------------------------------------------------------------------------------------

class Point:
    """11 numbers of a row: normal_f, normal_b, tangent, |N_f|, |N_b|; and 17 of a yarn type. Where the fibres of another yarn bend what
    is transmitted: their tangent and that slab's thickness."""

    def __init__(self, point, yarn, t_t=None, thickness_t=None):
        self.n_f, self.n_b, self.t = unit(point[..., 0:3]), unit(point[..., 3:6]), unit(point[..., 6:9])
        self.len_f, self.len_b = point[..., 9], point[..., 10]
        self.a_r, self.a_t, self.kd_r, self.kd_t = yarn[..., 0:3], yarn[..., 3:6], yarn[..., 6:9], yarn[..., 9:12]
        self.alpha_r, self.alpha_t, self.thickness, self.twist, self.mix = (yarn[..., k] for k in range(12, 17))
        self.t_t = self.t if t_t is None else unit(t_t)
        self.thickness_t = self.thickness if thickness_t is None else thickness_t


def mirror(w):
    return w * [1.0, 1.0, -1.0]


def diffuse(n, i, mix):
    """(w <n.i> + (1 - w) <n_s.i>) / pi [4.1]."""
    return (mix * np.maximum(dot(n, i), 0) + (1 - mix) * np.maximum(i[..., 2], 0)) / PI


def point_value(p, i, o, macro=False):
    """[6.1] divided by w(p, o) = <o.N_f> V_f / A_G: reflection K_r / c_o + F_rd, transmission |N_b|/|N_f| K_t / c_o + F_td."""
    c_o = dot(p.n_f, o)
    seen = (c_o > 0) & (i[..., 2] != 0)
    c_o = np.where(c_o > 0, c_o, 1)
    up = i[..., 2] > 0
    c_f, c_b = np.maximum(dot(p.n_f, i), 0), np.maximum(dot(p.n_b, mirror(i)), 0)
    # The slab's own cosines: of the ply, or macroscopic with f times the ply's cosine of i outside [3.5].
    s_o = np.where(macro, o[..., 2], c_o)
    s_f, s_b = np.where(macro, np.maximum(i[..., 2], 0), c_f), np.where(macro, np.maximum(-i[..., 2], 0), c_b)
    k_r = slab_reflect(sggx_d_half(i, o, p.t, p.alpha_r), sggx_sigma(i, p.t, p.alpha_r), sggx_sigma(o, p.t, p.alpha_r), s_f, s_o, p.thickness)
    k_t = slab_transmit(sggx_d_half(i, o, p.t_t, p.alpha_t), sggx_sigma(i, p.t_t, p.alpha_t), sggx_sigma(o, p.t_t, p.alpha_t), s_b, s_o, p.thickness_t)
    over_f, over_b = c_f / np.where(s_f > 0, s_f, 1), c_b / np.where(s_b > 0, s_b, 1)
    spec_r, spec_t = np.where(c_f > 0, k_r / s_o * over_f, 0), np.where(c_b > 0, k_t * p.len_b / (p.len_f * s_o) * over_b, 0)
    reflected = p.a_r * spec_r[..., None] + p.kd_r * diffuse(p.n_f, i, p.mix)[..., None]
    transmitted = p.a_t * spec_t[..., None] + p.kd_t * diffuse(p.n_b, mirror(i), p.mix)[..., None]
    return np.where(seen[..., None], np.where(up[..., None], reflected, transmitted), 0)


def lobe_weights(p):
    w = np.stack([luminance(c) for c in (p.a_r, p.a_t, p.kd_r, p.kd_t)], -1)
    total = w.sum(-1, keepdims=True)
    return np.where(total > 0, w / np.where(total > 0, total, 1), 0)


def point_pdf(p, i, o):
    """[6.5] with four lobes: the two slab lobes, Lambert mixes about n_f and n_s above, about n_b and n_s below."""
    w = lobe_weights(p)
    return (w[..., 0] * sggx_d_half(i, o, p.t, p.alpha_r) / (4 * sggx_sigma(o, p.t, p.alpha_r))
            + w[..., 1] * sggx_d_half(i, o, p.t_t, p.alpha_t) / (4 * sggx_sigma(o, p.t_t, p.alpha_t))
            + w[..., 2] * diffuse(p.n_f, i, p.mix) + w[..., 3] * diffuse(p.n_b, mirror(i), p.mix))


def point_sample(p, o, u_lobe, u):
    w = lobe_weights(p)
    edge = np.cumsum(w, -1)
    specular = u_lobe[..., 0] < edge[..., 1]
    back = u_lobe[..., 0] < edge[..., 0]
    m = sggx_sample_vndf(o, np.where(back[..., None], p.t, p.t_t), np.where(back, p.alpha_r, p.alpha_t), u)
    i_spec = 2 * dot(o, m)[..., None] * m - o
    above = (u_lobe[..., 0] < edge[..., 2]) | (w[..., 3] <= 0)
    n = np.where(above[..., None], p.n_f, p.n_b)
    n = np.where((u_lobe[..., 1] < p.mix)[..., None], n, [0.0, 0.0, 1.0])
    i_diff = to_world(frame(n), cosine_direction(u))
    i_diff = np.where(above[..., None], i_diff, mirror(i_diff))
    i = unit(np.where(specular[..., None], i_spec, i_diff))
    pdf = point_pdf(p, i, o)
    dead = (w.sum(-1) <= 0) | (pdf < 1e-12)
    return np.where(dead[..., None], [0.0, 0.0, 1.0], i), np.where(dead, 0, pdf)


# ---- visibility [8.5] ----------------------------------------------------------------------------------------------------------

SOFT = 0.06


def horizon_azimuth(d):
    """Azimuth in octants; inside an octant t + .3476 t (1 - t), t = min/max of |x|, |y| [8.5]."""
    a = np.abs(d)
    larger = a.max(-1)
    t = np.where(larger > 0, a.min(-1) / np.where(larger > 0, larger, 1), 0)
    f = t + 0.3476 * t * (1 - t)
    right, up, steep = d[..., 0] >= 0, d[..., 1] >= 0, a[..., 1] > a[..., 0]
    octant = np.select([right & up, ~right & up, ~right & ~up, right & ~up], [0, 4, 4, 8])
    sense = np.select([right & up, ~right & up, ~right & ~up, right & ~up], [1, -1, 1, -1])
    return octant + sense * np.where(steep, 2 - f, f)


def horizon_step(s, z):
    """lo = s - w, hi = min(s + w, 2 s), V = clamp((z - lo) / max(hi - lo, 1e-6)) [8.5]."""
    low, high = s - SOFT, np.minimum(s + SOFT, 2 * s)
    return np.clip((z - low) / np.maximum(high - low, 1e-6), 0, 1)


def horizon_visibility(knots, d):
    """knots (..., K), equal steps of azimuth, in [0, 255]."""
    count = knots.shape[-1]
    g = horizon_azimuth(d[..., :2]) * count / 8
    k = np.floor(g).astype(int)
    f = g - k
    def knot(index):
        return np.take_along_axis(knots, (index % count)[..., None], -1)[..., 0]
    s = knot(k) * (1 - f) + knot(k + 1) * f
    return np.where(d[..., 2] > 0, horizon_step(s / 255, d[..., 2]), 0)


def cap_visibility(words, d):
    """Ellipse with half axes a_x, a_y on the equal-area disc (u, v) = (d.x, d.y) sqrt(2 / (1 + d.mu)) about mu; soft by .05 [8.5]."""
    words = np.asarray(words, np.uint32)
    def signed(half):
        half = np.asarray(half, np.int64)
        return np.where(half >= 32768, half - 65536, half) / 32767
    x, y = signed(words[..., 0] & np.uint32(0xffff)), signed(words[..., 0] >> np.uint32(16))
    mu = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], -1)
    gamma = PI * (words[..., 1] & np.uint32(1023)) / 1024
    a_x = np.maximum((words[..., 1] >> np.uint32(10)) & np.uint32(2047), 0.5) * 4 / 2047
    a_y = np.maximum(words[..., 1] >> np.uint32(21), 0.5) * 4 / 2047
    f = frame(mu)
    along = np.cos(gamma)[..., None] * f[..., 0, :] + np.sin(gamma)[..., None] * f[..., 1, :]
    scale = np.sqrt(2 / np.maximum(1 + dot(mu, d), 1e-6))
    q = np.hypot(dot(along, d) * scale / a_x, dot(np.cross(mu, along), d) * scale / a_y)
    return np.where(d[..., 2] > 0, np.clip((1.05 - q) / 0.1, 0, 1), 0)


def unpack_knots(words):
    """(..., 2) words -> (..., 8) bytes, knot 0 in the lowest byte of the first."""
    words = np.asarray(words, np.uint32)
    return np.stack([(words[..., k // 4] >> np.uint32(8 * (k % 4))) & np.uint32(255) for k in range(8)], -1).astype(float)


# ---- packed maps (layout: bake/pack.hpp) ---------------------------------------------------------------------------------------

def decode_slopes(word):
    word = np.asarray(word, np.uint32)
    halves = np.stack([word & np.uint32(0xffff), word >> np.uint32(16)], -1).astype(np.int64)
    return np.where(halves >= 32768, halves - 65536, halves) * 4 / 32767


class Maps:
    """Tables of evaluate.py, decoded whole."""

    def __init__(self, tables):
        self.w, self.h = tables.size
        self.slopes = [decode_slopes(side[..., 0]) for side in tables.texels]
        packed = [np.asarray(side[..., 1], np.uint32) for side in tables.texels]
        self.azimuth = [PI * (side & np.uint32(0xffff)) / 65536 for side in packed]
        self.yarn = [((side >> np.uint32(16)) & np.uint32(127)).astype(int) for side in packed]
        self.gap = [(side >> np.uint32(23)) & np.uint32(1) == 1 for side in packed]
        self.openness = [(side >> np.uint32(24)) / 255 for side in packed]
        self.words = tables.horizons
        self.knots = [unpack_knots(side) for side in tables.horizons]
        self.heights = np.asarray(tables.heights, float)[:self.w * self.h].reshape(self.h, self.w)
        self.asg = np.asarray(tables.asg, float).reshape(self.h, self.w, 8)
        self.mips = [decode_slopes(side) for side in tables.mips]
        self.yarns = np.asarray(tables.yarns, float)

    def spot_at(self, tile):
        """Position in quarters of a texel."""
        size = 4 * np.array([self.w, self.h])
        return np.minimum(np.floor((tile - np.floor(tile)) * size).astype(int), size - 1)

    def texel_at(self, tile):
        return self.spot_at(tile) // 4

    def texel(self, side, x, y):
        """The 16 numbers of out_texel."""
        s, back = self.slopes[side][y, x], self.slopes[1 - side][y, x]
        n_f, n_b = np.array([-s[0], -s[1], 1]), np.array([-back[0], -back[1], 1])
        len_f, len_b = np.linalg.norm(n_f), np.linalg.norm(n_b)
        n_f, n_b = n_f / len_f, n_b / len_b
        a = self.azimuth[side][y, x]
        # The tangent lies over the azimuth and in the plane whose area vector is N.
        t_p = unit(np.array([np.cos(a), np.sin(a), s @ [np.cos(a), np.sin(a)]]))
        yarn = self.yarn[side][y, x]
        omega = self.yarns[yarn][15] * (1 if side == 0 else -1)
        t = np.cos(omega) * t_p + np.sin(omega) * np.cross(n_f, t_p)
        return np.concatenate([n_f, n_b, t, [len_f, len_b], s, [yarn, self.gap[side][y, x], self.openness[side][y, x]]])

    def bend(self, side, x, y, u):
        """Fibre tangent, albedo, roughness and thickness of the yarn that bends light on its way through two: the one in front, or for
        u < 1/2 the one that shows at the back, whose frame is mirrored; drawn half the time, it counts twice."""
        here = side if u >= 0.5 else 1 - side
        texel = self.texel(here, x, y)
        yarn = np.asarray(self.yarns[int(texel[13])])
        return np.r_[texel[6:9] * [1, 1, 1 if here == side else -1], 2 * yarn[3:6], yarn[13], yarn[14]]

    def horizon_at(self, spot):
        """Half-resolution texel of a spot. A full-resolution texel lies 3/4 in its own and 1/4 in the one beside it [8.5]; three of its
        quarters take the one, the outermost takes the other."""
        def axis(at, count):
            texel, quarter = divmod(at, 4)
            outermost = 0 if texel % 2 == 0 else 3
            beside = texel // 2 + (-1 if texel % 2 == 0 else 1)
            return (beside if quarter == outermost else texel // 2) % count
        return axis(int(spot[0]), self.w // 2), axis(int(spot[1]), self.h // 2)

    def visibility(self, side, spot, d):
        return float(horizon_visibility(self.knots[side][self.block(self.horizon_at(spot))][None], np.asarray(d, float)[None])[0])

    def block(self, corner):
        """Index of a half-resolution texel (x, y)."""
        return corner[1] * (self.w // 2) + corner[0]

    def visibility16(self, side, spot, d):
        """As visibility, with two words of eight knots."""
        first = 2 * self.block(self.horizon_at(spot))
        knots = np.concatenate([self.knots[side][first], self.knots[side][first + 1]])
        return float(horizon_visibility(knots[None], np.asarray(d, float)[None])[0])

    def clearance(self, side, x, y, d, tile_m, low, high):
        """Whether a ray from the texel's centre clears the heights, interpolated along the texel lines of the axis that it crosses
        fastest: all of them, until it is above the highest, or one tile or 16 height ranges have passed. Returns the least clearance
        as a share of the range: the ray is free where it is not negative."""
        if d[2] <= 0:
            return -1.0
        size, texel = np.array([self.w, self.h]), np.asarray(tile_m) / [self.w, self.h]
        height = self.heights / 65535 * (high - low)
        way = np.asarray(d[:2]) / texel             # texels for every metre that the ray's parameter grows
        axis = int(abs(way[1]) > abs(way[0]))
        if way[axis] == 0:
            return 1.0
        far = max(*tile_m, 16 * (high - low)) / np.hypot(*d[:2])
        count = int(np.ceil(min((height.max() + (high - low) - height[y, x]) / d[2], far) * abs(way[axis])))
        t = np.arange(1, count + 1) / abs(way[axis])
        p = np.array([x, y]) + t[:, None] * way
        fixed = np.rint(p[:, axis]).astype(int) % size[axis]
        base = np.floor(p[:, 1 - axis]).astype(int)
        f = p[:, 1 - axis] - base
        def at(row):
            row = row % size[1 - axis]
            return height[row, fixed] if axis == 0 else height[fixed, row]
        return float(np.min(height[y, x] + t * d[2] - at(base) * (1 - f) - at(base + 1) * f, initial=high - low)) / (high - low)

    def level_size(self, level):
        return max(1, self.w >> level), max(1, self.h >> level)

    def mean_slopes(self, side, tile, level):
        """Level 0 is the texel; past the last level, the last one."""
        if level <= 0:
            x, y = self.texel_at(tile)
            return self.slopes[side][y, x]
        top = int(np.floor(np.log2(max(self.w, self.h))))
        level = min(level, top)
        offset = sum(np.prod(self.level_size(k)) for k in range(1, level))
        w, h = self.level_size(level)
        f = tile - np.floor(tile)
        return self.mips[side][int(offset) + min(int(f[1] * h), h - 1) * w + min(int(f[0] * w), w - 1)]

    def area_from_mips(self, side, tile, dx, dy, o):
        """max(eps, o.z - o.x sbar_x - o.y sbar_y) at level log2 of the footprint's size in texels [6.2, 7]."""
        texels = abs(dx[0] * dy[1] - dx[1] * dy[0]) * self.w * self.h
        level = int(np.clip(np.floor(0.5 * np.log2(max(texels, 1)) + 0.5), 0, 31))
        mean = self.mean_slopes(side, tile, level)
        return max(o[2] - mean @ o[:2], 0.02)


# ---- metal ---------------------------------------------------------------------------------------------------------------------------

def ggx_d(h, alpha):
    """Walter et al. 2007, eq. 33, with the tangent: alpha^2 / (pi cos^4 (alpha^2 + tan^2)^2)."""
    cos2, sin2 = h[..., 2] ** 2, h[..., 0] ** 2 + h[..., 1] ** 2
    return alpha**2 / (np.pi * (alpha**2 * cos2 + sin2) ** 2)


def ggx_lambda(w, alpha):
    tan2 = (w[..., 0] ** 2 + w[..., 1] ** 2) / w[..., 2] ** 2
    return (-1 + np.sqrt(1 + alpha**2 * tan2)) / 2


def schlick(colour, cosine):
    return colour + (1 - colour) * np.clip(1 - cosine, 0, 1)[..., None] ** 5


def metal_value(colour, alpha, i, o):
    """F D G / (4 cos cos) times cos_i, G = 1 / (1 + Lambda + Lambda) (Heitz 2014)."""
    up = (i[..., 2] > 0) & (o[..., 2] > 0)
    i, o = (np.where(up[..., None], w, [0.0, 0.0, 1.0]) for w in (i, o))
    h = unit(i + o)
    g = 1 / (1 + ggx_lambda(i, alpha) + ggx_lambda(o, alpha))
    return np.where(up[..., None], schlick(colour, dot(h, o)) * (ggx_d(h, alpha) * g / (4 * o[..., 2]))[..., None], 0)


def metal_pdf(alpha, i, o):
    """Visible normals, D_o(h) = G1(o) max(o.h, 0) D(h) / cos_o, over the Jacobian 4 o.h of the reflection."""
    up = (i[..., 2] > 0) & (o[..., 2] > 0)
    i, o = (np.where(up[..., None], w, [0.0, 0.0, 1.0]) for w in (i, o))
    return np.where(up, ggx_d(unit(i + o), alpha) / (1 + ggx_lambda(o, alpha)) / (4 * o[..., 2]), 0)


def metal_sample(alpha, o, u):
    """Dupuy & Benyoub 2023: reflect about the sum of the stretched view and a uniform point of the cap that it sees."""
    v = unit(o * np.stack([alpha, alpha, np.ones_like(alpha)], -1))
    phi, z = 2 * np.pi * u[..., 0], 1 - u[..., 1] * (1 + v[..., 2])
    r = np.sqrt(np.clip((1 - z) * (1 + z), 0, 1))
    cap = np.stack([r * np.cos(phi), r * np.sin(phi), z], -1) + v
    h = unit(np.stack([alpha * cap[..., 0], alpha * cap[..., 1], np.maximum(cap[..., 2], 1e-6)], -1))
    i = unit(2 * dot(o, h)[..., None] * h - o)
    pdf = metal_pdf(alpha, i, o)
    return np.where((pdf > 0)[..., None], i, [0.0, 0.0, 1.0]), pdf


# ---- camera and surface -----------------------------------------------------------------------------------------------------------

def camera_ray(position, forward, right, up, resolution, raster):
    x = 2 * raster[..., 0] / resolution[..., 0] - 1
    y = 1 - 2 * raster[..., 1] / resolution[..., 1]
    direction = forward + right * x[..., None] + up * y[..., None]
    return position, direction, right * (2 / resolution[..., 0])[..., None], -up * (2 / resolution[..., 1])[..., None]


def barycentric(p0, p1, p2, point):
    """Least squares in the plane of the triangle: the same as projecting the point on it. 1/3 each for a triangle without area."""
    e1, e2, d = p1 - p0, p2 - p0, point - p0
    a, b, c = dot(e1, e1), dot(e1, e2), dot(e2, e2)
    r1, r2 = dot(e1, d), dot(e2, d)
    n = np.cross(e1, e2)
    n2 = dot(n, n)
    flat = n2 <= 0
    n2 = np.where(flat, 1, n2)
    return np.where(flat[..., None], 1 / 3, np.stack([(c * r1 - b * r2) / n2, (a * r2 - b * r1) / n2], -1))


def intersect(p0, p1, p2, origin, direction):
    """b1, b2 of the ray's point in the triangle's plane, and the distance along the ray: one 3x3 system."""
    m = np.stack([p1 - p0, p2 - p0, -direction], -1)
    solution = np.linalg.solve(m, (origin - p0)[..., None])[..., 0]
    return solution[..., :2], solution[..., 2]


# ---- lights -------------------------------------------------------------------------------------------------------------------------

def environment_direction(uv, rotation):
    """Latitude-longitude, y up: u = 1/2 + atan2(x, -z) / 2 pi, v = acos(y) / pi from the top row."""
    phi, theta = (uv[..., 0] - 0.5) * 2 * PI + rotation, uv[..., 1] * PI
    return np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], -1)


def environment_uv(d, rotation):
    u = 0.5 + (np.arctan2(d[..., 0], np.where((d[..., 0] == 0) & (d[..., 2] == 0), 1, -d[..., 2])) - rotation) / (2 * PI)
    return np.stack([u - np.floor(u), np.arctan2(np.hypot(d[..., 0], d[..., 2]), d[..., 1]) / PI], -1)


def environment(image, d, rotation, scale):
    """Bilinear between texel centres, periodic in u, held at the poles; pdf [1/sr] of the texel that holds d, given that
    image[..., 3] is the density over UV: dA_uv = d omega / (2 pi^2 sin theta)."""
    h, w = image.shape[:2]
    uv = environment_uv(d, rotation)
    x, y = uv[..., 0] * w - 0.5, uv[..., 1] * h - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    def at(ix, iy):
        return image[np.clip(iy, 0, h - 1), ix % w, :3]
    colour = (at(x0, y0) * (1 - fx) + at(x0 + 1, y0) * fx) * (1 - fy) + (at(x0, y0 + 1) * (1 - fx) + at(x0 + 1, y0 + 1) * fx) * fy
    density = image[np.minimum((uv[..., 1] * h).astype(int), h - 1), np.minimum((uv[..., 0] * w).astype(int), w - 1), 3]
    return np.concatenate([colour * scale, (density / (2 * PI**2 * np.maximum(np.hypot(d[..., 0], d[..., 2]), 1e-7)))[..., None]], -1)


# ---- colour -------------------------------------------------------------------------------------------------------------------------

def tone_neutral(c):
    """Khronos PBR Neutral, from the specification: F90 = .04, K_s = .8 - .04, K_d = .15."""
    x = c.min(-1)
    f = np.where(x <= 0.08, x - x**2 / (4 * 0.04), 0.04)
    c = c - f[..., None]
    peak = c.max(-1)
    k_s, k_d = 0.8 - 0.04, 0.15
    top = 1 - (1 - k_s) ** 2 / (np.maximum(peak, k_s) + 1 - 2 * k_s)
    g = 1 / (k_d * (np.maximum(peak, k_s) - top) + 1)
    bright = c * (top / np.where(peak > 0, peak, 1) * g)[..., None] + (top * (1 - g))[..., None]
    return np.where((peak <= k_s)[..., None], np.maximum(c, 0), bright)


def srgb(x):
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)


# ---- random numbers: integers, bit for bit ---------------------------------------------------------------------------------------------

M32 = 0xffffffff


def hash32(x):
    """lowbias32 (C. Wellons): xorshift 16, multiply 7feb352d, xorshift 15, multiply 846ca68b, xorshift 16."""
    x = int(x)
    for shift, factor in ((16, 0x7feb352d), (15, 0x846ca68b), (16, 1)):
        x = ((x ^ (x >> shift)) * factor) & M32
    return x


def hash_combine(seed, value):
    return hash32(seed ^ ((value + 0x9e3779b9 + (seed << 6) + (seed >> 2)) & M32))


def reverse_bits(x):
    return int(f"{x:032b}"[::-1], 2)


def laine_karras(x, seed):
    """Vegdahl 2021: x ^= x * 3d20adea; x += seed; x *= (seed >> 16) | 1; x ^= x * 05526c56; x ^= x * 53a22864."""
    x ^= (x * 0x3d20adea) & M32
    x = (x + seed) & M32
    x = (x * ((seed >> 16) | 1)) & M32
    x ^= (x * 0x05526c56) & M32
    x ^= (x * 0x53a22864) & M32
    return x


# Second Sobol dimension: direction numbers of the primitive polynomial x + 1, v_k = v_{k-1} ^ (v_{k-1} >> 1).
SOBOL_2 = [1 << 31]
for _ in range(31):
    SOBOL_2.append(SOBOL_2[-1] ^ (SOBOL_2[-1] >> 1))


def sobol_2(index):
    out = 0
    for k in range(32):
        if index >> k & 1:
            out ^= SOBOL_2[k]
    return out


def random_bits(seed, index, dimension):
    """Burley 2020: shuffle the index by an Owen scramble, take Sobol points 1 and 2, scramble each."""
    key = hash_combine(seed, dimension)
    def owen(x, s):
        return reverse_bits(laine_karras(reverse_bits(x), s))
    shuffled = owen(index, key)
    return (owen(reverse_bits(shuffled), hash32(key ^ 0xa511e9b3)), owen(sobol_2(shuffled), hash32(key ^ 0x63d83595)))


def block_length(planned):
    """Largest power of two up to 64 that leaves at least 16 blocks; 64 where nobody knows, 1 at least."""
    if planned == 0:
        return 64
    return next((length for length in (64, 32, 16, 8, 4, 2) if length * 16 <= planned), 1)


def unit_float(bits):
    return (bits >> 8) / 2**24


def select(maps, side, tile, dx, dy, o, bsdf, mode, visibility, seed, index, offset):
    """Which texel a ray sees [6.1, 6.4.2]: (passes, weight, texel's 16 numbers). bsdf 0 micro, 1 meso; mode 0 ours, 1 paper;
    visibility 0 none, 1 horizon8. Our mode draws four points of the additive recurrence R2, takes one in proportion to A_p, and
    draws again, up to three rounds, while none is visible; the paper's takes one point and weights it by A_p / A_G."""
    draw = {d: [unit_float(b) for b in random_bits(seed, index, offset + d)] for d in (1, 2, 3)}
    size = np.array([maps.w, maps.h])
    meso, resample, uses = bsdf == 1, bsdf == 1 and mode == 0, bsdf == 1 and visibility != 0
    def seen(s, spot, d):
        return maps.visibility(s, spot, d) if uses else float(d[2] > 0)
    total, chosen, area, u = 0.0, None, 0.0, draw[3][0]
    for j in range(12 if resample else 1):
        xi = np.array(draw[1]) + j * np.array([0.7548776662466927, 0.5698402909980532])
        xi = xi - np.floor(xi) - 0.5
        spot = maps.spot_at(tile + dx * xi[0] + dy * xi[1] + (np.array(draw[2]) - 0.5) / size)
        x, y = spot // 4
        a = max(o[2] - maps.slopes[side][y, x] @ o[:2], 0)
        if meso and a > 0:
            a *= seen(side, spot, o)
        total += a
        share = a / total if total > 0 else 0
        if j == 0 or u < share:
            chosen, area = spot, a
        if a > 0:
            u = u / share if u < share else (u - share) / max(1 - share, 1e-6)
        if j >= 3 and total > 0:
            break
    x, y = chosen // 4
    weight = area / maps.area_from_mips(side, tile, dx, dy, o) if meso and mode == 1 else 1.0
    texel = maps.texel(side, x, y)
    if maps.gap[side][y, x]:
        clear = seen(1 - side, chosen, np.array([-o[0], -o[1], o[2]])) if meso else 1.0
        if draw[3][1] < clear * min(weight, 1):
            return np.concatenate([[1], np.zeros(17)])
        if mode == 1:
            weight = 0.0
    if resample and total <= 0:
        texel[0:3], texel[9] = [0, 0, 1], 1
    return np.concatenate([[0, weight], texel])


def transmittance(maps, tile, d, bsdf, visibility, unscattered):
    """[5.2]: in a gap V V of the two sides; on a yarn, where the fibres let light through, U times that [3.1], weighted by A_p / d.z in the
    meso model. What is hidden by one yarn more passes it with its U."""
    spot = maps.spot_at(tile)
    x, y = spot // 4
    up = -d if d[2] < 0 else d
    share, between_fibres = 1.0, 0.0
    if up[2] <= 0 or not (unscattered or maps.gap[0][y, x]):
        return 0.0
    if unscattered:
        texel, yarn = maps.texel(0, x, y), maps.yarns[maps.yarn[0][y, x]]
        facing = texel[0:3] @ up
        between_fibres = np.exp(-min(yarn[14] * sggx_sigma(up, texel[6:9], yarn[13]) / max(facing, 1e-6), 80))
        if not maps.gap[0][y, x]:
            if facing <= 0:
                return 0.0
            share = between_fibres * (facing * texel[9] / up[2] if bsdf == 1 else 1)
    if bsdf == 0 or visibility == 0:
        return share
    v = maps.visibility(0, spot, up), maps.visibility(1, spot, np.array([-up[0], -up[1], up[2]]))
    return share * np.prod([side + (1 - side) * between_fibres for side in v])


def interreflection(albedo, openness):
    """I / (1 - a (1 - I)) - I [9.1]."""
    i = openness[..., None]
    return albedo * i * (1 - i) / np.maximum(1 - albedo * (1 - i), 1e-4)


def asg_visibility(mu, gamma, sigma_x, sigma_y, amplitude, d):
    """min(1, C max(mu.d, 0) exp(-sigma_x (d.x)^2 - sigma_y (d.y)^2)), x at angle gamma in the frame of mu [8.2, E6]."""
    x0, y0, _ = np.moveaxis(frame(mu), -2, 0) if np.asarray(frame(mu)).ndim > 2 else frame(mu)
    x = x0 * np.cos(gamma)[..., None] + y0 * np.sin(gamma)[..., None]
    y = np.cross(mu, x)
    value = amplitude * np.maximum(dot(mu, d), 0) * np.exp(-sigma_x * dot(x, d)**2 - sigma_y * dot(y, d)**2)
    return np.where(d[..., 2] > 0, np.minimum(value, 1), 0)


def noise(cell_x, cell_y, f):
    """Perlin 2002 with gradients (low half, high half of the hash, signed) / 2^15, hashed on integer cells."""
    def corner(dx, dy):
        mask = np.uint64(0xffffffff)
        cx, cy = (cell_x.astype(np.uint64) + np.uint64(dx)) & mask, (cell_y.astype(np.uint64) + np.uint64(dy)) & mask
        inner = np.array([hash32(int((c + np.uint64(0x9e3779b9)) & mask)) for c in cy], np.uint64)
        h = np.array([hash32(int(v)) for v in (cx * np.uint64(0x8da6b343) + inner) & mask])
        gx, gy = (((half ^ 0x8000) - 0x8000) / 2**15 for half in (h & 0xffff, h >> 16))
        return gx * (f[:, 0] - dx) + gy * (f[:, 1] - dy)
    w = f**3 * (f * (f * 6 - 15) + 10)
    low = corner(0, 0) * (1 - w[:, 0]) + corner(1, 0) * w[:, 0]
    high = corner(0, 1) * (1 - w[:, 0]) + corner(1, 1) * w[:, 0]
    return low * (1 - w[:, 1]) + high * w[:, 1]
