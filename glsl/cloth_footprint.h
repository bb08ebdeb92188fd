// Which point of the cloth a ray sees inside its footprint, and how much light crosses the cloth [math.md 5.2, 6].
// Shared; imports cloth_maps.h, random.h.

// What is evaluated: every ingredient of the model by itself. The programs' --mode, --bsdf and --visibility set several.
CLOTH_CONST int cloth_bsdf_micro = 0;       // ply-level BSDF at uniform points of the footprint: Jin et al. 2022 plus transmission
CLOTH_CONST int cloth_bsdf_meso  = 1;       // with shadowing and masking
CLOTH_CONST int cloth_weight_relief   = 0;  // the view ray is followed down to the point it meets [6.4.1]
CLOTH_CONST int cloth_weight_resample = 1;  // one of four candidates in proportion to its visible area [6.4.2]
CLOTH_CONST int cloth_weight_mips     = 2;  // A_p / A_G with A_G from the mean slopes: the paper [6.1]
CLOTH_CONST int cloth_weight_tile     = 3;  // A_p / A_G with A_G = o.z: right for footprints of a repeat and more [6.2]
CLOTH_CONST int cloth_visibility_none     = 0;
CLOTH_CONST int cloth_visibility_horizon8 = 1;
CLOTH_CONST int cloth_visibility_asg      = 2;

struct ClothSettings {
    int bsdf;
    int weight;
    int visibility;
    int slab;              // cloth_slab_ply or cloth_slab_macro
    bool unscattered;      // light that crosses a yarn without meeting a fibre [3.1, 5.2]
    bool interreflection;  // between yarns [9.1]
    bool twist_noise;
};

// Candidates of the resampling: bias 1.1 % at four [6.4.2]; stratified here, which only lowers it.
CLOTH_CONST int cloth_candidates = 4;
CLOTH_CONST real cloth_area_min  = real(0.02);   // floor of A_G in the paper's form [6.2]
// The march of the view ray: its longest step in texels, so that no ply (10 texels and more) is stepped over, and the most
// steps; longer ways get longer steps.
CLOTH_CONST real cloth_march_step = real(3);
CLOTH_CONST int cloth_march_steps = 48;

// Where a ray meets the cloth, in tiles of the fabric: centre and extent of one pixel step.
struct ClothFootprint {
    real2 tile;     // position, less `base`
    real2 dx;       // change per pixel step in x
    real2 dy;
    ivec2 base;     // whole repeats
};

struct ClothOcclusion {
    ClothHorizon horizon;
    real4 asg_axis;
    real4 asg_shape;
};

// A chosen point. `weight` multiplies cloth_point_value.
struct ClothSelection {
    bool passes;            // the ray goes straight through; nothing else is meaningful then
    real weight;
    ClothTexel texel;
    ClothYarn yarn;
    ClothOcclusion front;   // of the viewer's side
    ClothOcclusion back;
};

CLOTH_FN bool cloth_uses_visibility(ClothSettings settings)
{
    return settings.bsdf == cloth_bsdf_meso && settings.visibility != cloth_visibility_none;
}

CLOTH_FN ClothOcclusion cloth_occlusion(ClothMaps maps, int side, ivec2 xy, ClothSettings settings)
{
    ClothOcclusion occlusion;
    if (!cloth_uses_visibility(settings)) return occlusion;
    if (settings.visibility == cloth_visibility_asg) {
        occlusion.asg_axis  = cloth_fetch_asg(maps, side, xy, 0);
        occlusion.asg_shape = cloth_fetch_asg(maps, side, xy, 1);
    } else {
        occlusion.horizon = cloth_horizon(maps, side, xy);
    }
    return occlusion;
}

// V of a direction in the frame of the occlusion's side.
CLOTH_FN real cloth_visibility_of(ClothOcclusion occlusion, real3 d, ClothSettings settings)
{
    if (!cloth_uses_visibility(settings)) return d.z > real(0) ? real(1) : real(0);
    if (settings.visibility == cloth_visibility_asg) return cloth_asg_visibility(occlusion.asg_axis, occlusion.asg_shape, d);
    return cloth_horizon_visibility(occlusion.horizon, d);
}

// A_G of the paper: projected area of the footprint from the mean slopes of the mip level that matches it [6.2, 7].
CLOTH_FN real cloth_area_from_mips(ClothMaps maps, int side, ClothFootprint footprint, real3 o)
{
    real area  = abs(footprint.dx.x * footprint.dy.y - footprint.dx.y * footprint.dy.x) * real(maps.size.x) * real(maps.size.y);
    int level  = int(clamp(floor(real(0.5) * log2(max(area, real(1))) + real(0.5)), real(0), real(31)));
    real2 mean = cloth_mean_slopes(maps, side, footprint.tile, level);
    return max(o.z - dot(mean, real2(o.x, o.y)), cloth_area_min);
}

// First point of the height field that the view ray through `tile` on the mid-plane meets, in tiles [6.4.1].
//   u  in [0, 1) shifts the steps, so that what a step can miss averages out
CLOTH_FN real2 cloth_march(ClothMaps maps, int side, real2 tile, real3 o, real u)
{
    real low  = side == 0 ? maps.height_low.x : maps.height_low.y;
    real high = side == 0 ? maps.height_high.x : maps.height_high.y;
    real2 run = real2(o.x, o.y) / o.z / maps.tile_m;   // tiles per metre of height
    real2 way = run * (high - low);
    real texels = max(abs(way.x) * real(maps.size.x), abs(way.y) * real(maps.size.y));
    int steps   = int(clamp(ceil(texels / cloth_march_step), real(1), real(cloth_march_steps)));
    real above  = high;   // the last height known to be over the surface
    real below  = low;
    for (int k = 0; k < steps; ++k) {
        real z = high - (high - low) * (real(k) + u) / real(steps);
        if (cloth_height(maps, side, tile + run * z) >= z) {
            below = z;
            break;
        }
        above = z;
    }
    for (int k = 0; k < 5; ++k) {
        real z = real(0.5) * (above + below);
        if (cloth_height(maps, side, tile + run * z) >= z) below = z;
        else above = z;
    }
    return tile + run * below;
}

// Draws the point that the ray sees.
//   side    0 front, 1 back;  o  local direction to the viewer, o.z > 0
//   return  passes, or a point whose value times `weight` is an estimate of the effective BSDF with cosine
CLOTH_FN ClothSelection cloth_select(ClothMaps maps, int side, ClothFootprint footprint, real3 o, ClothSettings settings,
                                     ClothRandom random)
{
    real2 u_footprint = cloth_draw(random, cloth_dim_footprint);
    real2 u_texel     = cloth_draw(random, cloth_dim_texel);
    real2 u_pick      = cloth_draw(random, cloth_dim_pick);
    // Moving by up to half a texel each way before the nearest fetch is a bilinear filter in the mean.
    real2 half_texel  = (u_texel - real2(real(0.5))) / real2(real(maps.size.x), real(maps.size.y));

    bool meso      = settings.bsdf == cloth_bsdf_meso;
    bool relief    = meso && settings.weight == cloth_weight_relief;
    bool resample  = meso && settings.weight == cloth_weight_resample;
    int candidates = resample ? cloth_candidates : 1;
    real2 chosen   = footprint.tile;
    real area      = real(0);   // A_p of the chosen candidate
    real total     = real(0);
    real u         = u_pick.x;
    ClothOcclusion occlusion;
    // If every candidate is masked the draw is repeated, up to three rounds; then the last one is taken.
    for (int j = 0; j < candidates * 3; ++j) {
        // Additive recurrence R2 (Roberts 2018): every candidate is uniform, together they are spread over the footprint.
        real2 shift = real2(real(j) * real(0.7548776662466927), real(j) * real(0.5698402909980532));
        real2 xi    = u_footprint + shift;
        xi          = xi - floor(xi) - real2(real(0.5));
        real2 tile  = footprint.tile + footprint.dx * xi.x + footprint.dy * xi.y;
        if (relief) {
            chosen    = cloth_march(maps, side, tile, o, u_pick.x) + half_texel;
            occlusion = cloth_occlusion(maps, side, cloth_texel_at(maps, chosen), settings);
            break;
        }
        tile          = tile + half_texel;
        ivec2 xy      = cloth_texel_at(maps, tile);
        real2 slope   = cloth_decode_slopes(cloth_fetch_texel(maps, side, xy).x);
        ClothOcclusion here = cloth_occlusion(maps, side, xy, settings);
        real a        = max(o.z - dot(slope, real2(o.x, o.y)), real(0));
        if (meso && a > real(0)) a *= cloth_visibility_of(here, o, settings);
        total += a;
        // Reservoir of one: keep candidate j with probability a / total; u is stretched to be uniform again.
        real keep = total > real(0) ? a / total : real(0);
        bool take = u < keep || j == 0;
        if (a > real(0)) u = u < keep ? u / keep : (u - keep) / max(real(1) - keep, real(1e-6));
        if (take) {
            chosen    = tile;
            area      = a;
            occlusion = here;
        }
        if (j + 1 >= candidates && (total > real(0) || !resample)) break;
    }

    ClothSelection result;
    ivec2 xy      = cloth_texel_at(maps, chosen);
    ivec2 tile    = footprint.base + ivec2(int(floor(chosen.x)), int(floor(chosen.y)));
    result.passes = false;
    result.weight = real(1);
    result.front  = occlusion;
    result.back   = cloth_occlusion(maps, 1 - side, xy, settings);
    result.texel  = cloth_texel(maps, side, xy, settings.twist_noise ? tile : ivec2(0, 0), settings.twist_noise);
    result.yarn   = cloth_fetch_yarn(maps, result.texel.yarn);
    if (meso && settings.weight == cloth_weight_mips) result.weight = area / cloth_area_from_mips(maps, side, footprint, o);
    if (meso && settings.weight == cloth_weight_tile) result.weight = area / o.z;

    // A point that turns out to face away (filtered slopes under the march, or nothing visible found) is seen as a flat one.
    if ((relief && dot(result.texel.point.normal_f, o) <= real(1e-3) * o.z) || (resample && total <= real(0))) {
        result.texel.point.normal_f = real3(real(0), real(0), real(1));
        result.texel.point.length_f = real(1);
    }
    // Straight through a gap if the line clears the yarns behind as well. A gap point that does not is the flank of its
    // nearest yarn, shaded with n_s [5.2]; the paper has no flank. Through a yarn goes what meets no fibre. A weight other
    // than 1 is spent as a probability, which saturates above 1: it cannot be carried to the next layer.
    real through = real(0);
    if (result.texel.gap) through = real(1);
    else if (settings.unscattered && meso) through = cloth_unscattered(result.texel.point, result.yarn, o);
    if (through > real(0) && meso) through *= cloth_visibility_of(result.back, real3(-o.x, -o.y, o.z), settings);
    result.passes = u_pick.y < through * min(result.weight, real(1));
    if (result.texel.gap && !result.passes && !relief && !resample && meso) result.weight = real(0);
    return result;
}

// Share of the light travelling along d that crosses the cloth at a point without being scattered. Zero footprint: the mean
// over the cloth is T_d [5.2], with the light between the fibres of a yarn added where the settings ask for it.
//   d  local unit direction of travel, either way;  return in [0, inf): mean over the repeat <= 1
CLOTH_FN real cloth_transmittance(ClothMaps maps, real2 tile, real3 d, ClothSettings settings)
{
    ivec2 xy   = cloth_texel_at(maps, tile);
    bool gap   = cloth_texel_is_gap(cloth_fetch_texel(maps, 0, xy));
    bool inside = settings.unscattered && settings.bsdf == cloth_bsdf_meso;
    real3 up   = d.z < real(0) ? -d : d;   // the same line, leaving the front
    if (up.z <= real(0) || !(gap || inside)) return real(0);
    real share = real(1);
    if (!gap) {
        ClothTexel texel = cloth_texel(maps, 0, xy, ivec2(0, 0), false);
        real facing      = dot(texel.point.normal_f, up);
        if (facing <= real(0)) return real(0);
        share = cloth_unscattered(texel.point, cloth_fetch_yarn(maps, texel.yarn), up) * facing * texel.point.length_f / up.z;
    }
    if (!cloth_uses_visibility(settings)) return share;
    return share * cloth_visibility_of(cloth_occlusion(maps, 0, xy, settings), up, settings) *
           cloth_visibility_of(cloth_occlusion(maps, 1, xy, settings), real3(-up.x, -up.y, up.z), settings);
}
