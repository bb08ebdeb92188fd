// Visibility V(d) of a texel: horizon knots [math.md 8.5], our choice, an elliptic cap [8.5], and the paper's anisotropic
// spherical Gaussian [8.2, 8.3]. Shared; imports cloth_bsdf.h.

// Half width of the soft step of V, in sin(elevation) [8.5].
CLOTH_CONST real cloth_horizon_soft = real(0.06);

// Azimuth of d in knots, [0, 8), without atan2: max error .005 octants [8.5]. d.xy = 0 gives 0 [hazard 11].
CLOTH_FN real cloth_horizon_azimuth(real2 d)
{
    real ax = abs(d.x), ay = abs(d.y);
    real larger = ax < ay ? ay : ax, smaller = ax < ay ? ax : ay;   // min and max look for NaN, which llvmpipe needs three instructions for
    real t = larger > real(0) ? smaller / larger : real(0);
    real f = t + real(0.3476) * t * (real(1) - t);
    // Mirrored at the diagonal and at the axes where d lies beyond: |0 - g| is g. No branches, which a processor could only guess.
    real g = abs(real(ax < ay) * real(2) - f);
    g      = abs(real(d.x < real(0)) * real(4) - g);
    return abs(real(d.y < real(0)) * real(8) - g);
}

CLOTH_FN real cloth_horizon_knot(uvec2 word, uint k)
{
    uint half_word = k < 4u ? word.x : word.y;
    return real((half_word >> (8u * (k & 3u))) & 255u);
}

// Soft step of d.z over the horizon s, rim-aware: an unoccluded texel (s = 0) stays 1 down to the rim [8.5].
CLOTH_FN real cloth_horizon_step(real s, real z)
{
    real low = s - cloth_horizon_soft;   // the step ends at min(s + soft, 2 s)
    return clamp((z - low) / min(real(2) * cloth_horizon_soft, s + cloth_horizon_soft), real(0), real(1));
}

// V from knot k on by `part` of the way to the next.
CLOTH_FN real cloth_horizon_between(uvec2 knots, uint k, real part, real z)
{
    real s = mix(cloth_horizon_knot(knots, k & 7u), cloth_horizon_knot(knots, (k + 1u) & 7u), part);
    return cloth_horizon_step(s * (real(1) / real(255)), z);
}

// V in [0, 1] of a unit direction d, d.z > 0, in the frame of the knots' side; 0 at and below the horizontal.
//   knots  eight, packed: one half-resolution texel
CLOTH_FN real cloth_horizon_visibility(uvec2 knots, real3 d)
{
    if (d.z <= real(0)) return real(0);
    real g = cloth_horizon_azimuth(real2(d.x, d.y));
    real k = floor(g);
    return cloth_horizon_between(knots, uint(k), g - k, d.z);
}

// The same of a straight way through the cloth: up on the front, (-up.x, -up.y, up.z) on the back, which is half a turn away.
//   knots  of the front xy, of the back zw;  return  V of front and back
CLOTH_FN real2 cloth_horizon_visibilities(uvec4 knots, real3 up)
{
    if (up.z <= real(0)) return real2(real(0));
    real g = cloth_horizon_azimuth(real2(up.x, up.y));
    real k = floor(g);
    return real2(cloth_horizon_between(uvec2(knots.x, knots.y), uint(k), g - k, up.z),
                 cloth_horizon_between(uvec2(knots.z, knots.w), uint(k) + 4u, g - k, up.z));
}

// The paper's V: amplitude times ASG, min(1, .), with the clamp that Eq. 8 lost [0, E6].
//   axis   xyz mean direction mu, w angle gamma of the x axis about mu;  shape  x, y bandwidths, z amplitude C
CLOTH_FN real cloth_asg_visibility(real4 axis, real4 shape, real3 d)
{
    real3 mu     = real3(axis.x, axis.y, axis.z);
    real along   = dot(mu, d);
    if (along <= real(0) || d.z <= real(0)) return real(0);
    ClothFrame f = cloth_frame(mu);
    real3 x      = f.x * cos(axis.w) + f.y * sin(axis.w);
    real dx = dot(x, d), dy = dot(cross(mu, x), d);
    return min(shape.z * along * exp(-shape.x * dx * dx - shape.y * dy * dy), real(1));
}

// Half width of the soft rim of a cap, in radii [8.4]; largest axis that its word holds: pi a_1 a_2 is at most 2 pi.
CLOTH_CONST real cloth_cap_soft     = real(0.05);
CLOTH_CONST real cloth_cap_axis_max = real(4);

// V of an elliptic cap: an ellipse on the equal-area disc about its mean direction [8.5]. The word is that of bake's pack_cap.
CLOTH_FN real cloth_cap_visibility(uvec2 word, real3 d)
{
    if (d.z <= real(0)) return real(0);
    int mx = int(word.x << 16u) >> 16, my = int(word.x) >> 16;
    real3 mu     = real3(real(mx), real(my), sqrt(real(max(32767 * 32767 - mx * mx - my * my, 0)))) / real(32767);   // exact below the root
    real gamma   = real(word.y & 1023u) * (cloth_pi / real(1024));
    real a_x     = max(real((word.y >> 10u) & 2047u), real(0.5)) * (cloth_cap_axis_max / real(2047));
    real a_y     = max(real(word.y >> 21u), real(0.5)) * (cloth_cap_axis_max / real(2047));
    ClothFrame f = cloth_frame(mu);
    real3 x      = f.x * cos(gamma) + f.y * sin(gamma);
    real scale   = sqrt(real(2) / max(real(1) + dot(mu, d), real(1e-6)));
    real u = dot(x, d) * scale / a_x, v = dot(cross(mu, x), d) * scale / a_y;
    return clamp((real(1) + cloth_cap_soft - sqrt(u * u + v * v)) / (real(2) * cloth_cap_soft), real(0), real(1));
}
