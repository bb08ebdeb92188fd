// Irregularity of the fibre twist along the cloth: the paper's N(p). Shared; imports random.h, cloth_bsdf.h.

// Mean |noise| of cloth_noise over the plane (2e7 random cells and positions), so that an amplitude can be stated as the mean deviation.
CLOTH_CONST real cloth_noise_mean_abs = real(0.1398);

// Gradient times offset; both components of the gradient are uniform in [-1, 1). Unit gradients would cost a sine and a cosine.
CLOTH_FN real cloth_noise_corner(uint x, uint row, real2 d)
{
    uint h = cloth_hash(x * 0x8da6b343u + row);
    return (real(int(h << 16u) >> 16) * d.x + real(int(h) >> 16) * d.y) / real(32768);
}

// Gradient noise with gradients hashed on integer cells: no period, no loss of digits far from the origin (math.md 10,
// hazard 17). Footprints larger than a cell average it by their samples, so it never needs a level of detail.
//   cell  integer part of the position, f  fraction in [0, 1);  return in (-2, 2), mean 0
//   source  Perlin 2002, "Improving Noise"
CLOTH_FN real cloth_noise(uvec2 cell, real2 f)
{
    real2 w = f * f * f * (f * (f * real(6) - real(15)) + real(10));
    uint low  = cloth_hash(cell.y + 0x9e3779b9u);
    uint high = cloth_hash(cell.y + 1u + 0x9e3779b9u);
    real a  = cloth_noise_corner(cell.x, low, f);
    real b  = cloth_noise_corner(cell.x + 1u, low, f - real2(real(1), real(0)));
    real c  = cloth_noise_corner(cell.x, high, f - real2(real(0), real(1)));
    real d  = cloth_noise_corner(cell.x + 1u, high, f - real2(real(1), real(1)));
    return mix(mix(a, b, w.x), mix(c, d, w.x), w.y);
}
