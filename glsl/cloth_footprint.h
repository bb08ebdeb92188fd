// Which point of the cloth a ray sees inside its footprint, and whether a gap lets the ray through [math.md 5.2, 6].
// Shared; imports cloth_maps.h, random.h.

// What is evaluated. Values are those of the programs' options; blocks.h carries them to the shader.
CLOTH_CONST int cloth_bsdf_micro = 0;       // ply-level BSDF at uniform points of the footprint: Jin et al. 2022 plus transmission
CLOTH_CONST int cloth_bsdf_meso  = 1;       // with shadowing and masking
CLOTH_CONST int cloth_mode_ours  = 0;       // points drawn in proportion to their visible area [6.4.2]
CLOTH_CONST int cloth_mode_paper = 1;       // uniform points weighted by A_p / A_G [6.1]
CLOTH_CONST int cloth_visibility_none     = 0;
CLOTH_CONST int cloth_visibility_horizon8 = 1;

// Candidates of the resampling: bias 1.1 % at four [6.4.2]; stratified here, which only lowers it.
CLOTH_CONST int cloth_candidates = 4;
CLOTH_CONST real cloth_area_min  = real(0.02);   // floor of A_G in the paper's form [6.2]

struct ClothSettings {
    int bsdf;
    int mode;
    int visibility;
};

// Where a ray meets the cloth, in tiles of the fabric: centre and extent of one pixel step.
struct ClothFootprint {
    real2 tile;     // position, in [0, 1) plus any integer
    real2 dx;       // change per pixel step in x
    real2 dy;
};

// A chosen point. `weight` multiplies cloth_point_value.
struct ClothSelection {
    bool passes;            // the ray goes straight through; nothing else is meaningful then
    real weight;
    ClothTexel texel;
    ClothHorizon horizon_f;
    ClothHorizon horizon_b;
};

CLOTH_FN bool cloth_uses_visibility(ClothSettings settings)
{
    return settings.bsdf == cloth_bsdf_meso && settings.visibility != cloth_visibility_none;
}

CLOTH_FN real cloth_visibility_of(ClothHorizon horizon, real3 d, ClothSettings settings)
{
    if (!cloth_uses_visibility(settings)) return d.z > real(0) ? real(1) : real(0);
    return cloth_horizon_visibility(horizon, d);
}

// A_G of the paper: projected area of the footprint from the mean slopes of the mip level that matches it [6.2, 7].
CLOTH_FN real cloth_area_from_mips(ClothMaps maps, int side, ClothFootprint footprint, real3 o)
{
    real area  = abs(footprint.dx.x * footprint.dy.y - footprint.dx.y * footprint.dy.x) * real(maps.size.x) * real(maps.size.y);
    int level  = int(clamp(floor(real(0.5) * log2(max(area, real(1))) + real(0.5)), real(0), real(31)));
    real2 mean = cloth_mean_slopes(maps, side, footprint.tile, level);
    return max(o.z - dot(mean, real2(o.x, o.y)), cloth_area_min);
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
    real2 texel_size  = real2(real(1) / real(maps.size.x), real(1) / real(maps.size.y));

    bool resample  = settings.bsdf == cloth_bsdf_meso && settings.mode == cloth_mode_ours;
    int candidates = resample ? cloth_candidates : 1;
    ivec2 chosen   = ivec2(0, 0);
    uvec2 word     = uvec2(0u, 0u);
    real area      = real(0);   // A_p of the chosen candidate
    real total     = real(0);
    real u         = u_pick.x;
    ClothHorizon horizon;
    // If every candidate is masked the draw is repeated, up to three rounds; then the last one is taken.
    for (int j = 0; j < candidates * 3; ++j) {
        // Additive recurrence R2 (Roberts 2018): every candidate is uniform, together they are spread over the footprint.
        real2 shift   = real2(real(j) * real(0.7548776662466927), real(j) * real(0.5698402909980532));
        real2 xi      = u_footprint + shift;
        xi            = xi - floor(xi) - real2(real(0.5), real(0.5));
        // Moving by up to half a texel each way before the nearest fetch is a bilinear filter in the mean.
        real2 xi_t    = (u_texel - real2(real(0.5), real(0.5))) * texel_size;
        ivec2 xy      = cloth_texel_at(maps, footprint.tile + footprint.dx * xi.x + footprint.dy * xi.y + xi_t);
        uvec2 front   = cloth_fetch_texel(maps, side, xy);
        real2 slope   = cloth_decode_slopes(front.x);
        ClothHorizon h;
        if (cloth_uses_visibility(settings)) h = cloth_horizon(maps, side, xy);
        real a = max(o.z - dot(slope, real2(o.x, o.y)), real(0));
        if (settings.bsdf == cloth_bsdf_meso && a > real(0)) a *= cloth_visibility_of(h, o, settings);
        total += a;
        // Reservoir of one: keep candidate j with probability a / total; u is stretched to be uniform again.
        real keep = total > real(0) ? a / total : real(0);
        bool take = u < keep || j == 0;
        if (a > real(0)) u = u < keep ? u / keep : (u - keep) / max(real(1) - keep, real(1e-6));
        if (take) {
            chosen  = xy;
            word    = front;
            area    = a;
            horizon = h;
        }
        if (j + 1 >= candidates && (total > real(0) || !resample)) break;
    }

    ClothSelection result;
    result.passes    = false;
    result.weight    = real(1);
    result.horizon_f = horizon;
    if (cloth_uses_visibility(settings)) result.horizon_b = cloth_horizon(maps, 1 - side, chosen);
    if (settings.bsdf == cloth_bsdf_meso && settings.mode == cloth_mode_paper)
        result.weight = area / cloth_area_from_mips(maps, side, footprint, o);
    if (cloth_texel_is_gap(word)) {
        // Straight through if the line clears the yarns behind as well. A gap point that does not is the flank of its nearest
        // yarn, shaded with n_s [5.2]. The paper's form has no flank, and spends the weight of a gap point as a probability,
        // which saturates where A_p > A_G.
        real open = settings.bsdf == cloth_bsdf_micro ? real(1)
                                                      : cloth_visibility_of(result.horizon_b, real3(-o.x, -o.y, o.z), settings);
        result.passes = u_pick.y < open * min(result.weight, real(1));
        if (settings.mode == cloth_mode_paper) result.weight = real(0);
    }
    if (!result.passes) {
        result.texel = cloth_texel(maps, side, chosen);
        if (resample && total <= real(0)) {   // nothing visible was found: a flat point, seen as it is
            result.texel.point.normal_f = real3(real(0), real(0), real(1));
            result.texel.point.length_f = real(1);
        }
    }
    return result;
}

// Whether a ray that crosses the cloth at a point passes through it. Zero footprint: the mean over the cloth is T_d [5.2].
//   d  local unit direction of travel, either way;  u in [0, 1) decides where the horizon is soft
CLOTH_FN bool cloth_passes(ClothMaps maps, real2 tile, real3 d, ClothSettings settings, real u)
{
    ivec2 xy = cloth_texel_at(maps, tile);
    if (!cloth_texel_is_gap(cloth_fetch_texel(maps, 0, xy))) return false;
    if (!cloth_uses_visibility(settings)) return true;
    real3 up = d.z < real(0) ? -d : d;   // the same line, leaving the front
    if (up.z <= real(0)) return false;
    return u < cloth_horizon_visibility(cloth_horizon(maps, 0, xy), up) *
                   cloth_horizon_visibility(cloth_horizon(maps, 1, xy), real3(-up.x, -up.y, up.z));
}
