// Lights: a kind is one constant (cloth_types.h), one branch in cloth_light_sample and, where it has extent, one in
// cloth_light_hit. Shared; imports cloth_bsdf.h, cloth_fetch.h, random.h.

// The kinds that can occur, as bits. A shader that is told which (CLOTH_LIGHT_KINDS) has no code for the others.
#ifndef CLOTH_LIGHT_KINDS
#define CLOTH_LIGHT_KINDS 127
#endif
CLOTH_FN bool cloth_light_is(CLOTH_IN(ClothLight) light, int kind)
{
    return (CLOTH_LIGHT_KINDS & (1 << kind)) != 0 && (CLOTH_LIGHT_KINDS == (1 << kind) || light.kind == kind);
}

struct ClothLightSample {
    real3 wi;          // unit, world, toward the light
    real distance;     // [m]; a large number for lights at infinity
    real3 radiance;    // of a delta light: irradiance at normal incidence
    real pdf;          // [1/sr]; 0: nothing arrives; 1 for a delta light
};

CLOTH_CONST real cloth_far = real(1e30);

CLOTH_FN ClothLightSample cloth_no_light()
{
    return ClothLightSample(real3(real(0), real(0), real(1)), cloth_far, real3(real(0)), real(0));
}

CLOTH_FN bool cloth_light_is_delta(CLOTH_IN(ClothLight) light)
{
    return cloth_light_is(light, cloth_light_point) || cloth_light_is(light, cloth_light_spot) || cloth_light_is(light, cloth_light_flash) ||
           (cloth_light_is(light, cloth_light_directional) && light.shape.x <= real(0));
}

// Objects of more triangles are not looked for by BSDF sampling: a ray would have to ask them all.
CLOTH_CONST real cloth_emitter_hits_max = real(128);

// Lights that BSDF sampling can find with profit: the environment, rectangles and small meshes; a sun only where the
// surface is nearly a mirror, which is narrower than the sun.
CLOTH_FN bool cloth_light_wants_bsdf(CLOTH_IN(ClothLight) light, bool mirror)
{
    return cloth_light_is(light, cloth_light_environment) || cloth_light_is(light, cloth_light_area) ||
           (cloth_light_is(light, cloth_light_mesh) && light.shape.y <= cloth_emitter_hits_max) ||
           (mirror && cloth_light_is(light, cloth_light_directional) && light.shape.x > real(0));
}

// Radiance that an object sends to whoever sees it by itself: from its front only.
CLOTH_FN real3 cloth_emitted(CLOTH_IN(ClothLight) light, int side)
{
    return side == 0 ? light.radiance : real3(real(0));
}

// ---- environment: latitude-longitude, y up; u = 1/2 + atan2(x, -z) / 2 pi, v = acos(y) / pi from the top row ----------------

//   sine, cosine  of the angle to the upper pole
CLOTH_FN real3 cloth_environment_toward(real u, real sine, real cosine, real rotation)
{
    real phi = (u - real(0.5)) * real(2) * cloth_pi + rotation;
    return real3(sin(phi) * sine, cosine, -cos(phi) * sine);
}

CLOTH_FN real3 cloth_environment_direction(real2 uv, real rotation)
{
    real theta = uv.y * cloth_pi;
    return cloth_environment_toward(uv.x, sin(theta), cos(theta), rotation);
}

CLOTH_FN real2 cloth_environment_uv(real3 d, real rotation)
{
    real azimuth = d.x == real(0) && d.z == real(0) ? real(0) : atan(d.x, -d.z);
    real u       = real(0.5) + (azimuth - rotation) / (real(2) * cloth_pi);
    // atan2 of the horizontal part keeps the angle exact near the poles, where acos does not.
    real theta   = atan(sqrt(d.x * d.x + d.z * d.z), d.y);
    return real2(u - floor(u), clamp(theta / cloth_pi, real(0), real(1)));
}

// Radiance (bilinear, periodic in u) and pdf (of the texel) at a place [texels]; w is the pdf [1/sr].
//   texel, within  its texel, and where in it, [0, 1];  sine  of the angle to the pole
CLOTH_FN real4 cloth_environment_at(CLOTH_IN(ClothLights) lights, real3 scale, ivec2 texel, real2 within, real sine)
{
    ivec2 size  = lights.environment_size;
    real2 c     = real2(real(texel.x) + (within.x - real(0.5)), real(texel.y) + (within.y - real(0.5)));
    int x0 = int(floor(c.x)), y0 = int(floor(c.y));
    real fx = c.x - real(x0), fy = c.y - real(y0);
    int xa = x0 < 0 ? x0 + size.x : x0, xb = x0 + 1 >= size.x ? 0 : x0 + 1;
    int ya = max(y0, 0), yb = min(y0 + 1, size.y - 1);
    real4 top    = mix(cloth_fetch_environment(lights, ivec2(xa, ya)), cloth_fetch_environment(lights, ivec2(xb, ya)), fx);
    real4 bottom = mix(cloth_fetch_environment(lights, ivec2(xa, yb)), cloth_fetch_environment(lights, ivec2(xb, yb)), fx);
    real4 colour = mix(top, bottom, fy);
    real density = cloth_fetch_environment(lights, texel).w;
    return real4(real3(colour.x, colour.y, colour.z) * scale, density / (real(2) * cloth_pi * cloth_pi * max(sine, real(1e-7))));
}

// The same in direction d.
CLOTH_FN real4 cloth_environment(CLOTH_IN(ClothLights) lights, CLOTH_IN(ClothLight) light, real3 d)
{
    ivec2 size  = lights.environment_size;
    real2 uv    = cloth_environment_uv(d, light.shape.x);
    real2 place = real2(uv.x * real(size.x), uv.y * real(size.y));
    ivec2 texel = ivec2(min(int(place.x), size.x - 1), min(int(place.y), size.y - 1));
    return cloth_environment_at(lights, light.radiance, texel, place - real2(real(texel.x), real(texel.y)), sqrt(d.x * d.x + d.z * d.z));
}

// Where random bits fall among `count` shares of the table that begin at `first`: the distribution inverted, so that points that
// are stratified stay so. By a guide table the search begins where it ends or just before: two look-ups in the mean.
//   source  Chen & Asau 1974, "On generating random variates from an empirical distribution"
//   u       [0, 1), what 32 bits do not tell
struct ClothInversion {
    int at;
    real within;   // where in the share, [0, 1)
    real left;     // 1 - within, with all its digits
};

CLOTH_FN int cloth_inversion_guide(int first, int count, uint bits)
{
    return first + int(cloth_multiply_high(bits, uint(count)));
}

CLOTH_FN ClothInversion cloth_invert(CLOTH_IN(ClothLights) lights, int first, int count, uint bits, real u)
{
    int at   = int(cloth_fetch_inversion(lights, cloth_inversion_guide(first, count, bits)).y);
    uint end = cloth_fetch_inversion(lights, first + at).x;
    while (at + 1 < count && bits >= end) {
        ++at;
        end = cloth_fetch_inversion(lights, first + at).x;
    }
    uint begin = at > 0 ? cloth_fetch_inversion(lights, first + at - 1).x : 0u;
    real share = max(real(end - begin), real(1));
    return ClothInversion(at, min((real(bits - begin) + u) / share, real(0.99999994)), max((real(end - bits) - u) / share, real(6e-8)));
}

// Row of the environment, and column in a row.
CLOTH_FN ClothInversion cloth_environment_row(CLOTH_IN(ClothLights) lights, uint bits, real u)
{
    return cloth_invert(lights, lights.environment_size.x * lights.environment_size.y, lights.environment_size.y, bits, u);
}

CLOTH_FN ClothInversion cloth_environment_column(CLOTH_IN(ClothLights) lights, int row, uint bits, real u)
{
    return cloth_invert(lights, row * lights.environment_size.x, lights.environment_size.x, bits, u);
}

// ---- the kinds ----------------------------------------------------------------------------------------------------------------

// Samples a light from a point. u on the emitter; bits choose the place in the environment, or the triangle of a mesh.
CLOTH_FN ClothLightSample cloth_light_sample(CLOTH_IN(ClothLights) lights, CLOTH_IN(ClothLight) light, real3 position, real2 u, uvec2 bits)
{
    if (cloth_light_is(light, cloth_light_environment)) {
        ClothInversion y = cloth_environment_row(lights, bits.y, u.y);
        ClothInversion x = cloth_environment_column(lights, y.at, bits.x, u.x);
        ivec2 size = lights.environment_size;
        // The angle from the nearer pole: close to the lower one v does not tell it.
        real above = real(y.at) + y.within, below = real(size.y - 1 - y.at) + y.left;
        real theta = min(above, below) / real(size.y) * cloth_pi, sine = sin(theta);
        real3 wi   = cloth_environment_toward((real(x.at) + x.within) / real(size.x), sine, cos(theta) * (above <= below ? real(1) : real(-1)), light.shape.x);
        real4 seen = cloth_environment_at(lights, light.radiance, ivec2(x.at, y.at), real2(x.within, y.within), sine);
        wi         = normalize(wi);
        return ClothLightSample(wi, cloth_far, real3(seen.x, seen.y, seen.z), seen.w);
    }
    if (cloth_light_is(light, cloth_light_directional)) {
        if (light.shape.x <= real(0)) return ClothLightSample(light.axis, cloth_far, light.radiance, real(1));
        // Uniform in the cone; 1 - cos is kept as such, since cos of a small angle has no digits left in float.
        real x    = light.shape.x * u.x;
        real sine = sqrt(x * (real(2) - x)), phi = real(2) * cloth_pi * u.y;
        real3 wi  = cloth_to_world(cloth_frame(light.axis), real3(sine * cos(phi), sine * sin(phi), real(1) - x));
        // Irradiance E at normal incidence comes from radiance E / (pi sin^2); sin^2 = x_max (2 - x_max).
        real pdf  = real(1) / (real(2) * cloth_pi * light.shape.x);
        return ClothLightSample(normalize(wi), cloth_far,
                                light.radiance / (cloth_pi * light.shape.x * (real(2) - light.shape.x)), pdf);
    }
    real3 target = light.position, facing = light.axis;
    real area    = real(0);   // of an emitter that has one [m2]
    if (cloth_light_is(light, cloth_light_area)) {
        target = target + light.edge_u * (real(2) * u.x - real(1)) + light.edge_v * (real(2) * u.y - real(1));
        area   = real(4) * length(cross(light.edge_u, light.edge_v));
    }
    if (cloth_light_is(light, cloth_light_mesh)) {
        int first         = int(light.shape.x);
        ClothEmitter part = cloth_fetch_emitter(lights, first + int(cloth_multiply_high(bits.x, uint(light.shape.y))));
        if (bits.y >= part.threshold) part = cloth_fetch_emitter(lights, first + int(part.other));
        real root = sqrt(u.x);   // uniform in area (Turk 1990, "Generating random points in triangles")
        target    = part.p0 + part.e1 * (real(1) - root) + part.e2 * (u.y * root);
        facing    = normalize(cross(part.e1, part.e2));
        area      = light.edge_u.x;
    }
    real3 to   = target - position;
    real dist2 = dot(to, to);
    if (!(dist2 > real(1e-20))) return cloth_no_light();   // at zero distance there is no direction
    real distance = sqrt(dist2);
    real3 wi      = to * (real(1) / distance);
    real cosine   = -dot(wi, facing);
    if (area > real(0)) {
        if (cosine <= real(1e-6)) return cloth_no_light();   // as cloth_light_hit
        return ClothLightSample(wi, distance, light.radiance, dist2 / (cosine * area));
    }
    real lobe = real(1);
    if (cloth_light_is(light, cloth_light_flash)) lobe = max(cosine, real(0));
    if (cloth_light_is(light, cloth_light_spot)) {
        real x = clamp((cosine - light.shape.x) / max(light.shape.y - light.shape.x, real(1e-6)), real(0), real(1));
        lobe   = x * x * (real(3) - real(2) * x);
    }
    return ClothLightSample(wi, distance, light.radiance * (lobe / dist2), lobe > real(0) ? real(1) : real(0));
}

// What a ray from `position` along wi finds of a light that has extent: radiance, and the pdf that cloth_light_sample has there.
CLOTH_FN ClothLightSample cloth_light_hit(CLOTH_IN(ClothLights) lights, CLOTH_IN(ClothLight) light, real3 position, real3 wi)
{
    if (cloth_light_is(light, cloth_light_environment)) {
        real4 seen = cloth_environment(lights, light, wi);
        return ClothLightSample(wi, cloth_far, real3(seen.x, seen.y, seen.z), seen.w);
    }
    if (cloth_light_is(light, cloth_light_directional)) {
        real3 off = wi - light.axis;   // 1 - cos is half its square
        if (!(real(0.5) * dot(off, off) <= light.shape.x) || light.shape.x <= real(0)) return cloth_no_light();
        return ClothLightSample(wi, cloth_far, light.radiance / (cloth_pi * light.shape.x * (real(2) - light.shape.x)),
                                real(1) / (real(2) * cloth_pi * light.shape.x));
    }
    if (cloth_light_is(light, cloth_light_mesh)) {
        real3 centre = light.position - position;
        real3 across = centre - wi * dot(centre, wi);
        if (dot(across, across) > light.edge_u.y * light.edge_u.y) return cloth_no_light();
        // The nearest triangle, whichever way it faces: the ray goes no further.
        int first     = int(light.shape.x), count = int(light.shape.y);
        real distance = cloth_far, cosine = real(0);
        for (int k = 0; k < count; ++k) {   // Moeller & Trumbore 1997
            ClothEmitter part = cloth_fetch_emitter(lights, first + k);
            real3 p   = cross(wi, part.e2), s = position - part.p0;
            real3 q   = cross(s, part.e1);
            real det  = dot(part.e1, p);
            real b1   = dot(s, p) / det, b2 = dot(wi, q) / det, t = dot(part.e2, q) / det;
            if (!(b1 >= real(0) && b2 >= real(0) && b1 + b2 <= real(1) && t > real(0) && t < distance)) continue;
            distance  = t;
            cosine    = -dot(wi, normalize(cross(part.e1, part.e2)));
        }
        if (cosine <= real(1e-6)) return cloth_no_light();
        return ClothLightSample(wi, distance, light.radiance, distance * distance / (cosine * light.edge_u.x));
    }
    if (cloth_light_is(light, cloth_light_area)) {
        real cosine = -dot(wi, light.axis);
        if (cosine <= real(1e-6)) return cloth_no_light();
        real distance = -dot(light.position - position, light.axis) / cosine;
        if (distance <= real(0)) return cloth_no_light();
        real3 on = position + wi * distance - light.position;
        if (abs(dot(on, light.edge_u)) > dot(light.edge_u, light.edge_u) || abs(dot(on, light.edge_v)) > dot(light.edge_v, light.edge_v))
            return cloth_no_light();
        real area = real(4) * length(cross(light.edge_u, light.edge_v));
        return ClothLightSample(wi, distance, light.radiance, distance * distance / (cosine * area));
    }
    return cloth_no_light();
}
