// Display transform and error metrics: one definition for window, programs and tests. Shared; imports interop.h.

// Tone curve that keeps base colours and compresses only highlights, linear Rec.709 in and out, [0, inf) -> [0, 1].
//   source  Khronos PBR Neutral Tone Mapper, specification 2024
CLOTH_FN real3 cloth_tone_neutral(real3 colour)
{
    real start = real(0.8) - real(0.04), desaturation = real(0.15);
    real x      = min(colour.x, min(colour.y, colour.z));
    real offset = x < real(0.08) ? x - real(6.25) * x * x : real(0.04);
    colour      = colour - real3(offset);
    real peak   = max(colour.x, max(colour.y, colour.z));
    if (peak < start) return max(colour, real3(real(0)));
    real d        = real(1) - start;
    real new_peak = real(1) - d * d / (peak + d - start);
    colour        = colour * (new_peak / peak);
    real g        = real(1) - real(1) / (desaturation * (peak - new_peak) + real(1));
    return mix(colour, real3(new_peak), g);
}

// sRGB transfer function (IEC 61966-2-1), linear [0, 1] -> [0, 1].
CLOTH_FN real cloth_srgb_channel(real x)
{
    return x <= real(0.0031308) ? real(12.92) * x : real(1.055) * pow(x, real(1) / real(2.4)) - real(0.055);
}

CLOTH_FN real3 cloth_srgb(real3 colour)
{
    return real3(cloth_srgb_channel(colour.x), cloth_srgb_channel(colour.y), cloth_srgb_channel(colour.z));
}

// Scene-linear radiance to display code values; exposure in stops. NaN stays visible as magenta instead of passing for black.
CLOTH_FN real3 cloth_display(real3 radiance, real exposure)
{
    if (!(radiance.x + radiance.y + radiance.z > real(-1e30))) return real3(real(1), real(0), real(1));
    return cloth_srgb(cloth_tone_neutral(max(radiance, real3(real(0))) * exp2(exposure)));
}

// One term of relMSE: squared error over squared reference, floored so that black stays finite (docs: interface.md).
CLOTH_FN real cloth_relmse_term(real value, real reference)
{
    real d = value - reference;
    return d * d / (reference * reference + real(0.01));
}
