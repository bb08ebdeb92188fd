// Irregularity of the fibre twist along the cloth: the paper's N(p). Shared; imports random.h, cloth_bsdf.h.

// Mean |noise| of cloth_noise over the plane, so that an amplitude can be stated as the mean deviation.
CLOTH_CONST real cloth_noise_mean_abs = real(0.1763);

CLOTH_FN real cloth_noise_corner(uvec2 cell, real2 d)
{
    uint h   = cloth_hash(cell.x * 0x8da6b343u + cloth_hash(cell.y + 0x9e3779b9u));
    real phi = cloth_unit(h) * real(2) * cloth_pi;
    return cos(phi) * d.x + sin(phi) * d.y;
}

// Gradient noise with unit gradients hashed on integer cells: no period, no loss of digits far from the origin (math.md 10,
// hazard 17). Footprints larger than a cell average it by their samples, so it never needs a level of detail.
//   cell  integer part of the position, f  fraction in [0, 1);  return in [-1, 1], mean 0
//   source  Perlin 2002, "Improving Noise"
CLOTH_FN real cloth_noise(uvec2 cell, real2 f)
{
    real2 w = f * f * f * (f * (f * real(6) - real(15)) + real(10));
    real a  = cloth_noise_corner(cell, f);
    real b  = cloth_noise_corner(cell + uvec2(1u, 0u), f - real2(real(1), real(0)));
    real c  = cloth_noise_corner(cell + uvec2(0u, 1u), f - real2(real(0), real(1)));
    real d  = cloth_noise_corner(cell + uvec2(1u, 1u), f - real2(real(1), real(1)));
    return mix(mix(a, b, w.x), mix(c, d, w.x), w.y);
}
