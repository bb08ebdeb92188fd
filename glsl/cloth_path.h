// From one vertex of a path to the next: everything but the rays. Shared; imports cloth_direct.h. Both renderers do
//   ClothBounce b = cloth_bounce(...);  if (b.any) follow cloth_bounce_ray(b) with b.throughput, less what the roulette ends
// and count at each vertex cloth_direct alone: what a bounce ray meets that shines, and the environment, it has counted already.

// Surfaces that scatter along a path, at most, where nothing else is asked for.
CLOTH_CONST int cloth_path_depth = 32;

// Bounces that Russian roulette never cuts short; most that it lets a path go on, or white scenes would have no end.
CLOTH_CONST int cloth_roulette_start   = 3;
CLOTH_CONST real cloth_survival_max    = real(0.95);

// A bounce has no pixel; it sees as wide a spot as its lobe is wide: half the side of a square of solid angle 1/pdf. So a
// diffuse bounce averages over repeats of a fabric, which is what it would do with many samples (math.md 10, hazard 18).
CLOTH_CONST real cloth_bounce_spread_min = real(1e-3);
CLOTH_CONST real cloth_bounce_spread_max = real(0.25);

struct ClothBounce {
    bool any;          // false: the path ends here
    real3 origin;      // off the surface, on the side of wi
    real3 wi;          // unit, world
    real pdf;          // of wi [1/sr]
    real3 throughput;  // of the path so far
};

// A direction from BSDF sampling, with the dimensions that cloth_direct has for it: both are unbiased, whatever they share.
//   maps        of the fabric that the shading was chosen from; anything where it is matte
//   throughput  of the path up to this vertex
CLOTH_FN ClothBounce cloth_bounce(CLOTH_IN(ClothMaps) maps, CLOTH_IN(ClothSurface) surface, CLOTH_IN(ClothShading) shading,
                                  ClothSettings settings, ClothRandom random, real3 throughput)
{
    ClothBounce none = ClothBounce(false, surface.position, surface.normal_g, real(0), real3(real(0)));
    ClothSample s    = cloth_shading_sample(shading, surface.wo, settings, cloth_draw(random, cloth_dim_lobe), cloth_draw(random, cloth_dim_direction));
    if (s.pdf <= real(0)) return none;
    real3 wi  = cloth_to_world(surface.frame, s.wi);
    // As in cloth_direct: both normals must agree on the side.
    real side = dot(wi, surface.normal_g);
    if (s.wi.z * side <= real(0)) return none;
    throughput = throughput * (cloth_shading_value(maps, shading, s.wi, surface.wo, settings) / s.pdf);
    if (!(max(throughput.x, max(throughput.y, throughput.z)) > real(0))) return none;
    return ClothBounce(true, cloth_leave(surface.position, side > real(0) ? surface.normal_g : -surface.normal_g), normalize(wi), s.pdf, throughput);
}

// With the width that a fabric's footprint is made of.
CLOTH_FN ClothRay cloth_bounce_ray(ClothBounce bounce)
{
    real spread      = clamp(real(0.5) / sqrt(bounce.pdf), cloth_bounce_spread_min, cloth_bounce_spread_max);
    ClothFrame frame = cloth_frame(bounce.wi);
    return ClothRay(bounce.origin, bounce.wi, frame.x * spread, frame.y * spread);
}

// Russian roulette: how likely a path goes on, by which its throughput is divided then. Drawn with cloth_dim_pixel of the next
// vertex, which has no pixel filter.
CLOTH_FN real cloth_survival(real3 throughput)
{
    return min(max(throughput.x, max(throughput.y, throughput.z)), cloth_survival_max);
}
