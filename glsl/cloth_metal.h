// Metal beside the cloth (a mirror ball, poles, rings): GGX microfacets with Schlick's Fresnel. Local frame, z the normal.
// Shared; imports cloth_bsdf.h.

// Roughness below which half vectors in float no longer tell the lobe's shape; at 1e-3 a surface mirrors to a twentieth of a degree.
CLOTH_CONST real cloth_metal_alpha_min = real(1e-3);

// GGX density of normals h (unit, either sign of z) [1/sr]; D cos integrates to 1 over the hemisphere.
//   source  Walter et al. 2007, "Microfacet models for refraction through rough surfaces", eq. 33; written with the sine of h,
//           which has no difference of numbers near 1
CLOTH_FN real cloth_ggx_d(real3 h, real alpha)
{
    real a2 = alpha * alpha;
    real s  = (h.x * h.x + h.y * h.y) + a2 * h.z * h.z;
    return a2 / (cloth_pi * s * s);
}

// Length of w stretched by the roughness: sqrt(cos^2 + alpha^2 sin^2), which Smith's masking is made of.
CLOTH_FN real cloth_ggx_stretch(real3 w, real alpha)
{
    return sqrt(w.z * w.z + alpha * alpha * (w.x * w.x + w.y * w.y));
}

// Reflectance at normal incidence to that at cos_h, the cosine between ray and micro normal.
//   source  Schlick 1994, "An inexpensive BRDF model for physically-based rendering", eq. 15
CLOTH_FN real3 cloth_fresnel_schlick(real3 colour, real cos_h)
{
    real m  = clamp(real(1) - cos_h, real(0), real(1));
    real m2 = m * m;
    return colour + (real3(real(1)) - colour) * (m2 * m2 * m);
}

// BRDF times the cosine of i; 0 where a direction is below the surface.
//   source  Heitz 2014, "Understanding the masking-shadowing function in microfacet-based BRDFs", eq. 99 (height-correlated)
//   colour  reflectance at normal incidence, [0, 1];  alpha  [cloth_metal_alpha_min, 1]
CLOTH_FN real3 cloth_metal_value(real3 colour, real alpha, real3 i, real3 o)
{
    if (i.z <= real(0) || o.z <= real(0)) return real3(real(0));
    real3 h    = normalize(i + o);
    real both  = i.z * cloth_ggx_stretch(o, alpha) + o.z * cloth_ggx_stretch(i, alpha);
    return cloth_fresnel_schlick(colour, dot(h, o)) * (cloth_ggx_d(h, alpha) * i.z * real(0.5) / both);
}

// Density of cloth_metal_sample [1/sr]: the visible normals', brought to reflected directions.
CLOTH_FN real cloth_metal_pdf(real alpha, real3 i, real3 o)
{
    if (i.z <= real(0) || o.z <= real(0)) return real(0);
    return cloth_ggx_d(normalize(i + o), alpha) / (real(2) * (o.z + cloth_ggx_stretch(o, alpha)));
}

// Reflects o about a visible normal; pdf 0 where that leads below the surface.
//   source  Dupuy & Benyoub 2023, "Sampling visible GGX normals with spherical caps"
//   u       [0, 1)^2
CLOTH_FN ClothSample cloth_metal_sample(real alpha, real3 o, real2 u)
{
    real3 v   = normalize(real3(alpha * o.x, alpha * o.y, max(o.z, real(0))));
    real drop = u.y * (real(1) + v.z);   // 1 - z of a point of the cap, uniform: its sine keeps its digits at the top
    real sine = sqrt(max(drop * (real(2) - drop), real(0))), phi = real(2) * cloth_pi * u.x;
    real3 cap = real3(sine * cos(phi), sine * sin(phi), real(1) - drop) + v;
    real3 h   = normalize(real3(alpha * cap.x, alpha * cap.y, max(cap.z, real(1e-6))));
    real3 i   = normalize(real(2) * dot(o, h) * h - o);
    real pdf  = cloth_metal_pdf(alpha, i, o);
    if (!(pdf > real(0))) return ClothSample(real3(real(0), real(0), real(1)), real(0));
    return ClothSample(i, pdf);
}
