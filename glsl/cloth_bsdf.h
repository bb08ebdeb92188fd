// THE BSDF at a point of a ply: fibre SGGX, slab reflection and transmission, diffuse terms; value, pdf, sample.
//
// Conventions. wi (i) points to the light, wo (o) to the viewer, both leave the surface, both unit. Local frame: z is the
// macroscopic normal n_s on the viewer's side, x runs along +u (weft), y along +v (warp). o.z > 0 always; i.z > 0 is
// reflection, i.z < 0 transmission, i.z = 0 gives 0. Seen from behind, z is mirrored and the back maps are used, which are
// stored in the mirrored frame. Values include the incident cosine (math.md section 0, E2); pdf is per solid angle,
// 0 means "no sample". Colour is linear Rec.709. It samples no texture and owns no state.
// Source of every formula: math.md, section in brackets.
#if defined(__cplusplus) && !defined(CLOTH_BSDF_HPP)
#error "from C++ include cloth_bsdf.hpp: it instantiates this file as cloth::f32 and cloth::f64"
#endif

CLOTH_CONST real cloth_pi         = real(3.14159265358979323846);
CLOTH_CONST real cloth_alpha_min  = real(0.01);   // below it 8-bit tangents dominate [2.2]
CLOTH_CONST real cloth_cosine_min = real(1e-6);   // floor of cosines inside an optical depth [3.4]
CLOTH_CONST real cloth_depth_max  = real(80);     // exp(-80) is the smallest useful float [10, hazard 4]

// A point of the cloth as the BSDF sees it. Back quantities live in the mirrored frame.
struct ClothPoint {
    real3 normal_f;    // unit ply normal, front
    real3 normal_b;    // unit ply normal, back
    real3 tangent;     // unit fibre tangent, front
    real3 tangent_t;   // of the fibres that bend light on its way through: the same, or those of a yarn beneath
    real length_f;     // |N_f|, length of the area vector (-sx, -sy, 1); 1/(n_s.n_p)
    real length_b;     // |N_b|
};

struct ClothFrame {
    real3 x;
    real3 y;
    real3 z;
};

struct ClothSample {
    real3 wi;     // unit, toward the light, local frame
    real pdf;     // [1/sr]; 0 says "no sample", and wi is then (0, 0, 1), never undefined
};

CLOTH_FN real cloth_luminance(real3 colour)   // Rec.709 Y
{
    return dot(colour, real3(real(0.2126), real(0.7152), real(0.0722)));
}

CLOTH_FN real3 cloth_mirror(real3 w)   // to and from the frame of the back side
{
    return real3(w.x, w.y, -w.z);
}

// Orthonormal basis about a unit vector; defined for every n, n.z = -1 included.
//   source  Duff et al. 2017, "Building an Orthonormal Basis, Revisited"
CLOTH_FN ClothFrame cloth_frame(real3 n)
{
    real s = n.z >= real(0) ? real(1) : real(-1);
    real a = real(-1) / (s + n.z);
    real b = n.x * n.y * a;
    return ClothFrame(real3(real(1) + s * n.x * n.x * a, s * b, -s * n.x), real3(b, s + n.y * n.y * a, -n.y), n);
}

CLOTH_FN real3 cloth_to_world(ClothFrame frame, real3 w)
{
    return frame.x * w.x + frame.y * w.y + frame.z * w.z;
}

CLOTH_FN real3 cloth_to_local(ClothFrame frame, real3 w)
{
    return real3(dot(w, frame.x), dot(w, frame.y), dot(w, frame.z));
}

// Unit vector, or `fallback` where the length is nothing (math.md 10, hazard 8).
CLOTH_FN real3 cloth_unit_vector(real3 v, real3 fallback)
{
    real length2 = dot(v, v);
    return length2 < real(1e-20) ? fallback : v * (real(1) / sqrt(length2));
}

// ---- fibre SGGX -----------------------------------------------------------------------------------------------------

// Projected area of the flakes seen along w [2.2].
//   w, t   unit; alpha in [cloth_alpha_min, 1];  return in [alpha, 1]
CLOTH_FN real cloth_sggx_sigma(real3 w, real3 t, real alpha)
{
    real c      = dot(w, t);
    real3 w_x_t = cross(w, t);
    return sqrt(dot(w_x_t, w_x_t) + alpha * alpha * c * c);
}

// Normal distribution D of a direction h that need not be unit [2.2].
//   return  [1/sr]; the integral of D(h) max(0, w.h) over the sphere is sigma(w)
CLOTH_FN real cloth_sggx_d(real3 h, real3 t, real alpha)
{
    real c      = dot(h, t);
    real3 h_x_t = cross(h, t);
    real a2     = alpha * alpha;
    real q      = a2 * dot(h, h) / (a2 * dot(h_x_t, h_x_t) + c * c);
    return q * q / (cloth_pi * alpha);
}

// D averaged over all h perpendicular to o: the limit i -> -o, where the half vector has no direction [2.4].
CLOTH_FN real cloth_sggx_d_antiparallel(real3 o, real3 t, real alpha)
{
    real sigma = cloth_sggx_sigma(o, t, alpha);
    return (sigma * sigma + alpha * alpha) / (real(2) * cloth_pi * sigma * sigma * sigma);
}

// D at the half vector of i and o; the same half vector for reflection and transmission [3.2].
CLOTH_FN real cloth_sggx_d_half(real3 i, real3 o, real3 t, real alpha)
{
    real3 h = i + o;
    if (dot(h, h) < real(1e-8)) return cloth_sggx_d_antiparallel(o, t, alpha);
    return cloth_sggx_d(h, t, alpha);
}

// A flake normal m with density D_w(m) = max(0, w.m) D(m) / sigma(w), by the stretched cosine hemisphere [2.3].
//   u in [0, 1)^2
CLOTH_FN real3 cloth_sggx_sample_vndf(real3 w, real3 t, real alpha, real2 u)
{
    ClothFrame fibre    = cloth_frame(t);
    real3 w_fibre       = cloth_to_local(fibre, w);
    real3 w_stretched   = normalize(real3(w_fibre.x, w_fibre.y, alpha * w_fibre.z));
    ClothFrame stretched = cloth_frame(w_stretched);
    real radius = sqrt(u.x), phi = real(2) * cloth_pi * u.y;
    real3 m     = cloth_to_world(stretched, real3(radius * cos(phi), radius * sin(phi), sqrt(real(1) - u.x)));
    return cloth_to_world(fibre, normalize(real3(m.x, m.y, alpha * m.z)));
}

// ---- slab kernels: K = f c_i c_o per unit albedo [3.4] -----------------------------------------------------------------

// (1 - e^-x) / x for x >= 0; GLSL has no expm1.
CLOTH_FN real cloth_phi1(real x)
{
    if (x < real(0.1))
        return real(1) -
               x / real(2) * (real(1) - x / real(3) * (real(1) - x / real(4) * (real(1) - x / real(5) *
                              (real(1) - x / real(6) * (real(1) - x / real(7) * (real(1) - x / real(8)))))));
    return (real(1) - exp(-x)) / x;
}

// K_r of a slab of optical thickness T: 0 at grazing, symmetric in (i, o).
CLOTH_FN real cloth_slab_reflect(real d, real sigma_i, real sigma_o, real c_i, real c_o, real thickness)
{
    real depth = thickness * (sigma_i / max(c_i, cloth_cosine_min) + sigma_o / max(c_o, cloth_cosine_min));
    if (depth < real(0.1)) return real(0.25) * d * thickness * cloth_phi1(depth);
    real denominator = sigma_i * c_o + sigma_o * c_i;
    if (denominator <= real(0)) return real(0);
    return real(0.25) * d * c_i * c_o / denominator * (real(1) - exp(-min(depth, cloth_depth_max)));
}

// K_t; covers equal depths of i and o exactly.
CLOTH_FN real cloth_slab_transmit(real d, real sigma_i, real sigma_o, real c_i, real c_o, real thickness)
{
    real depth_i = thickness * sigma_i / max(c_i, cloth_cosine_min);
    real depth_o = thickness * sigma_o / max(c_o, cloth_cosine_min);
    return real(0.25) * d * thickness * exp(-min(min(depth_i, depth_o), cloth_depth_max)) * cloth_phi1(abs(depth_i - depth_o));
}

// ---- the point: value, pdf, sample ---------------------------------------------------------------------------------------

// Cosine terms of the two diffuse lobes: w about the ply normal, 1 - w about n_s, per unit albedo [4.1].
//   n, i  in the frame of the side that i lies on, i.z >= 0
CLOTH_FN real cloth_diffuse(real3 n, real3 i, real mix_w)
{
    return (mix_w * max(dot(n, i), real(0)) + (real(1) - mix_w) * max(i.z, real(0))) / cloth_pi;
}

// Which cosines the slab sees [3.5].
CLOTH_CONST int cloth_slab_ply   = 0;   // of the ply normal: conserves energy per point
CLOTH_CONST int cloth_slab_macro = 1;   // of the macroscopic normal, as Jin et al. 2022

// F of a visible point: value with cosine, divided by A_p/A_G, which whoever chose the point accounts for [6.1, 6.4].
//   return  [1/sr] rgb, no visibility of i yet; 0 where the point faces away from o
CLOTH_FN real3 cloth_point_value(CLOTH_IN(ClothPoint) p, CLOTH_IN(ClothYarn) yarn, real3 i, real3 o, int slab)
{
    real c_o = dot(p.normal_f, o);
    if (c_o <= real(0) || i.z == real(0)) return real3(real(0));
    bool reflected = i.z > real(0);
    real3 i_side   = real3(i.x, i.y, abs(i.z));
    real3 n_side   = reflected ? p.normal_f : p.normal_b;
    real3 tangent  = reflected ? p.tangent : p.tangent_t;
    real alpha     = reflected ? yarn.alpha_r : yarn.alpha_t;
    real3 albedo   = reflected ? yarn.albedo_r : yarn.albedo_t;
    real3 diffuse  = reflected ? yarn.diffuse_r : yarn.diffuse_t;
    real c_i       = max(dot(n_side, i_side), real(0));
    // K / c_o of the slab: f c_i. With macroscopic cosines f is that of the flat slab and only c_i stays local.
    // Both are divided by: below the floor of the optical depths the quotients would grow without bound.
    real k_i = max(slab == cloth_slab_macro ? i_side.z : c_i, cloth_cosine_min);
    real k_o = max(slab == cloth_slab_macro ? o.z : c_o, cloth_cosine_min);
    real f_i = real(0);
    if (c_i > real(0)) {
        real d       = cloth_sggx_d_half(i, o, tangent, alpha);
        real sigma_i = cloth_sggx_sigma(i, tangent, alpha), sigma_o = cloth_sggx_sigma(o, tangent, alpha);
        f_i = reflected ? cloth_slab_reflect(d, sigma_i, sigma_o, k_i, k_o, yarn.thickness)
                        : cloth_slab_transmit(d, sigma_i, sigma_o, k_i, k_o, yarn.thickness_t) * (p.length_b / p.length_f);
        f_i = f_i / k_o * (c_i / k_i);
    }
    return albedo * f_i + diffuse * cloth_diffuse(n_side, i_side, yarn.diffuse_mix);
}

// Share of light that crosses the slab along o without meeting a fibre: the U term of [3.1].
//   normal, tangent  of the ply, unit
CLOTH_FN real cloth_unscattered(CLOTH_IN(ClothYarn) yarn, real3 normal, real3 tangent, real3 o)
{
    real c_o = max(dot(normal, o), cloth_cosine_min);
    return exp(-min((yarn.thickness + yarn.beneath) * cloth_sggx_sigma(o, tangent, yarn.alpha_t) / c_o, cloth_depth_max));
}

// Light that reaches a point by way of other yarns, over all bounces, relative to what an open place receives: E - I_p with
// E = I_p / (1 - a (1 - I_p)) [9.1].
struct ClothRegained {
    real3 front;
    real3 back;
};

//   albedo  a, what a yarn gives on of the light that falls on it, [0, 1];  openness  I_p of front and back, (0, 1]
CLOTH_FN ClothRegained cloth_interreflection(real3 albedo, real2 openness)
{
    real3 rest  = real3(real(1)) - albedo;   // 1 - a (1 - openness) without cancelling:
    real3 front = max(rest + albedo * openness.x, real3(real(1e-4)));
    real3 back  = max(rest + albedo * openness.y, real3(real(1e-4)));
    real3 share = albedo / (front * back);   // one division for both
    return ClothRegained(share * back * (openness.x * (real(1) - openness.x)), share * front * (openness.y * (real(1) - openness.y)));
}

// Selection probabilities of the lobes at a point: x specular reflection, y specular transmission, z diffuse reflection,
// w diffuse transmission; in proportion to luminance [6.5]. All 0 for a black yarn.
CLOTH_FN real4 cloth_lobe_weights(CLOTH_IN(ClothYarn) yarn)
{
    real4 w    = real4(cloth_luminance(yarn.albedo_r), cloth_luminance(yarn.albedo_t), cloth_luminance(yarn.diffuse_r),
                       cloth_luminance(yarn.diffuse_t));
    real total = w.x + w.y + w.z + w.w;
    return total > real(0) ? w / total : real4(real(0));
}

CLOTH_FN real cloth_point_pdf(CLOTH_IN(ClothPoint) p, CLOTH_IN(ClothYarn) yarn, real3 i, real3 o)
{
    real4 lobe = cloth_lobe_weights(yarn);
    real pdf   = real(0);
    if (lobe.x > real(0))
        pdf += lobe.x * cloth_sggx_d_half(i, o, p.tangent, yarn.alpha_r) /
               (real(4) * cloth_sggx_sigma(o, p.tangent, yarn.alpha_r));
    if (lobe.y > real(0))
        pdf += lobe.y * cloth_sggx_d_half(i, o, p.tangent_t, yarn.alpha_t) /
               (real(4) * cloth_sggx_sigma(o, p.tangent_t, yarn.alpha_t));
    return pdf + lobe.z * cloth_diffuse(p.normal_f, i, yarn.diffuse_mix) +
           lobe.w * cloth_diffuse(p.normal_b, cloth_mirror(i), yarn.diffuse_mix);
}

// Direction with cosine density about n.
CLOTH_FN real3 cloth_cosine_sample(real3 n, real2 u)
{
    real radius = sqrt(u.x), phi = real(2) * cloth_pi * u.y;
    return cloth_to_world(cloth_frame(n), real3(radius * cos(phi), radius * sin(phi), sqrt(real(1) - u.x)));
}

// Samples the whole sphere with density cloth_point_pdf.
//   u_lobe  x chooses the lobe, y the mix of normals;  u  the direction; all in [0, 1)
CLOTH_FN ClothSample cloth_point_sample(CLOTH_IN(ClothPoint) p, CLOTH_IN(ClothYarn) yarn, real3 o, real2 u_lobe, real2 u)
{
    real4 lobe = cloth_lobe_weights(yarn);
    if (lobe.x + lobe.y + lobe.z + lobe.w <= real(0)) return ClothSample(real3(real(0), real(0), real(1)), real(0));
    real3 i;
    if (u_lobe.x < lobe.x + lobe.y) {
        bool reflected = u_lobe.x < lobe.x;
        real3 m        = cloth_sggx_sample_vndf(o, reflected ? p.tangent : p.tangent_t, reflected ? yarn.alpha_r : yarn.alpha_t, u);
        i              = real(2) * dot(o, m) * m - o;
    } else {
        bool reflected = u_lobe.x < lobe.x + lobe.y + lobe.z || lobe.w <= real(0);
        real3 n        = real3(real(0), real(0), real(1));
        if (u_lobe.y < yarn.diffuse_mix) n = reflected ? p.normal_f : p.normal_b;
        i = cloth_cosine_sample(n, u);
        if (!reflected) i = cloth_mirror(i);
    }
    i        = normalize(i);
    real pdf = cloth_point_pdf(p, yarn, i, o);
    if (pdf < real(1e-12)) return ClothSample(real3(real(0), real(0), real(1)), real(0));
    return ClothSample(i, pdf);
}
