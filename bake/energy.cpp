// bake/energy.cpp: quadrature over the shared slab functions; fits of math.md 9.2; Monte Carlo over the whole cloth.
#include "energy.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <vector>

#include <tbb/parallel_for.h>

namespace selvedge
{

namespace f32 = cloth::f32;
namespace f64 = cloth::f64;

glm::dvec3 slab_albedo(double alpha_r, double alpha_t, double thickness, double c_o, double across)
{
    constexpr int side = 48;
    const double s_o = std::sqrt(std::max(1 - c_o * c_o, 0.0));
    const glm::dvec3 t(1, 0, 0), o(s_o * std::sqrt(std::max(1 - across * across, 0.0)), s_o * across, c_o);
    glm::dvec3 albedo(0);
    for (const bool reflected : {true, false}) {
        const double alpha = reflected ? alpha_r : alpha_t;
        const double sigma_o = f64::cloth_sggx_sigma(o, t, alpha);
        double sum = 0;
        for (int a = 0; a < side; ++a)
            for (int b = 0; b < side; ++b) {
                // Flakes drawn by the VNDF: the value over the density has no D left (math.md 2.3).
                const glm::dvec3 m = f64::cloth_sggx_sample_vndf(o, t, alpha, {(a + 0.5) / side, (b + 0.5) / side});
                const glm::dvec3 i = 2 * glm::dot(o, m) * m - o;
                if ((i.z > 0) != reflected) continue;
                const double sigma_i = f64::cloth_sggx_sigma(i, t, alpha), c_i = std::abs(i.z);
                const double k = reflected ? f64::cloth_slab_reflect(1, sigma_i, sigma_o, c_i, c_o, thickness)
                                           : f64::cloth_slab_transmit(1, sigma_i, sigma_o, c_i, c_o, thickness);
                sum += k / c_o * 4 * sigma_o;
            }
        (reflected ? albedo.x : albedo.y) = sum / (side * side);
    }
    albedo.z = std::exp(-thickness * f64::cloth_sggx_sigma(o, t, alpha_t) / c_o);
    return albedo;
}

SlabTable slab_table(const YarnSpec& spec)
{
    constexpr double extreme_deg[SlabTable::extremes] = {0, 85, 89};
    const double alpha_r = double(spec.roughness),
                 alpha_t = double(spec.roughness_transmission.value_or(spec.roughness));
    constexpr int rows = (SlabTable::shares + SlabTable::extremes) * SlabTable::turns;
    SlabTable table;
    tbb::parallel_for(0, rows, [&](int k) {
        const int a = k / SlabTable::turns, b = k % SlabTable::turns;
        const bool share = a < SlabTable::shares;
        const double c_o = share ? std::sqrt((a + 0.5) / SlabTable::shares)
                                 : std::cos(glm::radians(extreme_deg[a - SlabTable::shares]));
        // Extremes along and across the fibre, too.
        const double turn = (share ? b + 0.5 : b * 1.5) / SlabTable::turns * 90;
        table.rows[k].angle_deg = glm::degrees(std::acos(c_o));
        table.rows[k].albedo = slab_albedo(alpha_r, alpha_t, double(spec.thickness), c_o, std::sin(glm::radians(turn)));
    });
    for (int k = 0; k < SlabTable::shares * SlabTable::turns; ++k)
        table.mean += table.rows[k].albedo / double(SlabTable::shares * SlabTable::turns);
    return table;
}

float rescattering_probability(float thickness)
{
    return 1 - 1 / (1 + 1.15f * thickness + 0.13f * thickness * thickness);
}

glm::vec2 rescattered_share(float thickness)
{
    // Hemispherical mean of what passes unscattered: 2 E3(T).
    constexpr int steps = 64;
    float through = 0;
    for (int i = 0; i < steps; ++i) {
        const float mu = (float(i) + 0.5f) / steps;
        through += 2 * mu * std::exp(-thickness / mu) / steps;
    }
    const float once = 0.26f + 0.74f * std::exp(-1.23f * std::pow(thickness, 0.9f)); // leaves after one scattering
    const float reflected = std::min(0.49f + 0.048f * thickness, 0.95f);             // fitted for T <= 4
    const float all = (1 - through) * (1 - once);
    return {all * reflected, all * (1 - reflected)};
}

// R1 + T1 in one channel of what is seen from a row's direction.
static double scattered_once(const cloth::f32::ClothYarn& yarn, const SlabTable::Row& row, int channel)
{
    return double(yarn.albedo_r[channel]) * row.albedo.x + double(yarn.albedo_t[channel]) * row.albedo.y;
}

YarnEnergy most_sent_out(const cloth::f32::ClothYarn& yarn, const SlabTable& slab)
{
    YarnEnergy worst;
    for (const SlabTable::Row& row : slab.rows)
        for (int c = 0; c < 3; ++c) {
            const double once = scattered_once(yarn, row, c);
            const double diffuse = double(yarn.diffuse_r[c]) + double(yarn.diffuse_t[c]);
            if (once + diffuse + row.albedo.z > worst.most)
                worst = {once + diffuse + row.albedo.z, row.angle_deg, c, once, diffuse, row.albedo.z};
        }
    return worst;
}

cloth::f32::ClothYarn shade_yarn(const YarnSpec& spec, glm::vec3 tint, const SlabTable& slab)
{
    cloth::f32::ClothYarn yarn{};
    yarn.albedo_r = spec.albedo * tint;
    yarn.albedo_t = spec.albedo_transmission.value_or(spec.albedo) * tint;
    if (spec.diffuse || spec.diffuse_transmission) {
        yarn.diffuse_r = spec.diffuse.value_or(glm::vec3(0)) * tint;
        yarn.diffuse_t = spec.diffuse_transmission.value_or(glm::vec3(0)) * tint;
    } else {
        const glm::vec2 share = rescattered_share(spec.thickness);
        const float again = rescattering_probability(spec.thickness);
        for (int c = 0; c < 3; ++c) {
            const auto kept = [&](float a) { return a * a * (1 - again) / (1 - a * again); };
            const float reflected = share.x * kept(yarn.albedo_r[c]), transmitted = share.y * kept(yarn.albedo_t[c]);
            double room = 1;
            for (const SlabTable::Row& row : slab.rows)
                room = std::min(room, 1 - row.albedo.z - scattered_once(yarn, row, c));
            const float scale = float(std::clamp(room / std::max(double(reflected + transmitted), 1e-9), 0.0, 1.0));
            yarn.diffuse_r[c] = scale * reflected;
            yarn.diffuse_t[c] = scale * transmitted;
        }
    }
    yarn.alpha_r = std::clamp(spec.roughness, 0.01f, 1.0f);
    yarn.alpha_t = std::clamp(spec.roughness_transmission.value_or(spec.roughness), 0.01f, 1.0f);
    yarn.thickness = yarn.thickness_t = spec.thickness;
    const double twist = glm::radians(double(spec.fibre_twist_deg));
    yarn.twist = {std::cos(twist), std::sin(twist)};
    yarn.diffuse_mix = spec.diffuse_mix;
    yarn.reflectance = yarn.diffuse_r + yarn.albedo_r * float(slab.mean.x);
    yarn.transmittance = yarn.diffuse_t + yarn.albedo_t * float(slab.mean.y);
    yarn.albedo = yarn.reflectance + yarn.transmittance + float(slab.mean.z);
    return yarn;
}

// Most that a slab lets through bent, in a channel of albedo 1, of what is seen from rows of the same angle as this
// one: the fibres of the yarn above it run another way.
static double bent(const SlabTable& slab, std::size_t row)
{
    const std::size_t first = row - row % SlabTable::turns;
    double most = 0;
    for (std::size_t k = first; k < first + SlabTable::turns; ++k) most = std::max(most, slab.rows[k].albedo.y);
    return most;
}

// What a channel of two yarns has left of light that is seen from a row's direction, beside what the upper one reflects
// and what meets no fibre.
static double room_beside(const cloth::f32::ClothYarn& upper, const cloth::f32::ClothYarn& lower,
                          const SlabTable::Row& row, int c)
{
    return 1 - double(upper.diffuse_r[c]) - double(upper.albedo_r[c]) * row.albedo.x -
           std::pow(row.albedo.z, 1 + double(lower.thickness) / double(upper.thickness));
}

// What the lobes of two yarns send to a row's direction.
static double lobes_at(const SlabTable& upper_slab, const SlabTable& lower_slab, std::size_t row, glm::dvec2 lobes)
{
    return lobes.x * upper_slab.rows[row].albedo.y + lobes.y * bent(lower_slab, row);
}

// The part of the lobes that there is room for at every angle.
static double part_with_room(const cloth::f32::ClothYarn& upper, const SlabTable& upper_slab,
                             const cloth::f32::ClothYarn& lower, const SlabTable& lower_slab, int c, glm::dvec2 lobes)
{
    double part = 1;
    for (std::size_t k = 0; k < std::size(upper_slab.rows); ++k)
        part = std::min(part, room_beside(upper, lower, upper_slab.rows[k], c) /
                                  std::max(lobes_at(upper_slab, lower_slab, k, lobes), 1e-9));
    return std::max(part, 0.0);
}

cloth::f32::ClothYarn stack_yarns(const cloth::f32::ClothYarn& upper, const SlabTable& upper_slab,
                                  const cloth::f32::ClothYarn& lower, const SlabTable& lower_slab)
{
    cloth::f32::ClothYarn stack = upper;
    const double u = upper_slab.mean.z, u_lower = lower_slab.mean.z;
    for (int c = 0; c < 3; ++c) {
        const double r = double(upper.reflectance[c]), r_lower = double(lower.reflectance[c]);
        const double t = double(upper.transmittance[c]) + u, t_lower = double(lower.transmittance[c]) + u_lower;
        const double between = 1 / std::max(1 - r * r_lower, 1e-6); // light to and fro between the two
        const double back = t * t * r_lower * between;
        // What either yarn bends and the other lets pass without meeting a fibre. The same from both sides.
        glm::dvec2 lobes(double(upper.albedo_t[c]) * u_lower, double(lower.albedo_t[c]) * u);
        lobes *= std::min(part_with_room(upper, upper_slab, lower, lower_slab, c, lobes),
                          part_with_room(lower, lower_slab, upper, upper_slab, c, {lobes.y, lobes.x}));
        const double lobe_mean = lobes.x * upper_slab.mean.y + lobes.y * lower_slab.mean.y;
        const double through = std::max(t * t_lower * between - u * u_lower - lobe_mean, 0.0);
        // Both are means over directions, too.
        double room = 1;
        for (std::size_t k = 0; k < std::size(upper_slab.rows); ++k)
            room = std::min(room, room_beside(upper, lower, upper_slab.rows[k], c) -
                                      lobes_at(upper_slab, lower_slab, k, lobes));
        const double scale = std::clamp(room / std::max(back + through, 1e-9), 0.0, 1.0);
        stack.albedo_t[c] = float(lobes.x);
        stack.diffuse_t[c] = float(scale * through);
        stack.diffuse_r[c] += float(scale * back);
        stack.reflectance[c] += float(scale * back);
        stack.transmittance[c] = float(scale * through + lobe_mean);
        stack.albedo[c] = stack.reflectance[c] + stack.transmittance[c] + float(u * u_lower);
    }
    stack.beneath = lower.thickness;
    return stack;
}

SkySample sample_sky(const f32::ClothMaps& maps, int side, const f32::ClothFootprint& footprint, glm::vec3 o,
                     const f32::ClothSettings& settings, f32::ClothRandom random)
{
    SkySample sample;
    sample.selection = f32::cloth_select(maps, side, footprint, o, settings, random);
    if (sample.selection.passes) return sample;
    const f32::ClothShading shading = f32::cloth_shade_fabric(sample.selection, settings);
    // Half the directions from the lobes, half from the cosine about n_s on both sides: the lobes leave out directions
    // behind the ply's horizon, from which interreflection still brings light.
    const glm::vec2 u_choice = f32::cloth_draw(random, f32::cloth_dim_light);
    const glm::vec2 u = f32::cloth_draw(random, f32::cloth_dim_direction);
    glm::vec3 i;
    if (u_choice.x < 0.5f) {
        const f32::ClothSample lobe =
            f32::cloth_shading_sample(shading, o, settings, f32::cloth_draw(random, f32::cloth_dim_lobe), u);
        if (lobe.pdf <= 0) return sample;
        i = lobe.wi;
    } else {
        i = f32::cloth_cosine_sample({0, 0, 1}, u);
        if (u_choice.y < 0.5f) i = f32::cloth_mirror(i);
    }
    const float pdf =
        0.5f * f32::cloth_shading_pdf(shading, i, o, settings) + 0.5f * std::abs(i.z) / (2 * f32::cloth_pi);
    if (pdf <= 0) return sample;
    (i.z > 0 ? sample.front : sample.back) = f32::cloth_shading_value(maps, shading, i, o, settings) / pdf;
    return sample;
}

ClothAlbedo cloth_albedo(const PackedFabric& fabric, int side, double angle_deg, int samples,
                         const f32::ClothSettings& settings)
{
    constexpr int block = 256; // stratified within; blocks are independent, which gives the error
    const int blocks = std::max(samples / block, 2);
    const f32::ClothMaps maps = maps_of(fabric);
    const float c = float(std::cos(angle_deg / 57.29577951308232)), s = std::sqrt(std::max(1 - c * c, 0.0f));
    std::vector<ClothAlbedo> means(static_cast<std::size_t>(blocks));
    tbb::parallel_for(0, blocks, [&](int b) {
        ClothAlbedo& mean = means[static_cast<std::size_t>(b)];
        for (int k = 0; k < block; ++k) {
            const f32::ClothRandom random{f32::cloth_hash(static_cast<glm::uint>(b) + 1), static_cast<glm::uint>(k), 0};
            const glm::vec2 turn = f32::cloth_draw(random, f32::cloth_dim_pixel);
            // Its own repeat, so that the twist noise is a new one.
            const glm::ivec2 base(int(f32::cloth_hash(random.seed + random.index) & 0xffffu), b);
            const f32::ClothFootprint footprint{{0.5f, 0.5f}, {1, 0}, {0, 1}, base};
            const float phi = 2 * f32::cloth_pi * turn.x;
            const SkySample sample =
                sample_sky(maps, side, footprint, {s * std::cos(phi), s * std::sin(phi), c}, settings, random);
            const double straight = sample.selection.passes ? 1 : 0;
            mean.reflectance += glm::dvec3(sample.front) / double(block);
            mean.transmittance += (glm::dvec3(sample.back) + straight) / double(block);
            mean.straight += straight / block;
        }
    });
    ClothAlbedo albedo;
    glm::dvec3 square(0);
    for (const ClothAlbedo& mean : means) {
        albedo.reflectance += mean.reflectance / double(blocks);
        albedo.transmittance += mean.transmittance / double(blocks);
        albedo.straight += mean.straight / blocks;
        const glm::dvec3 all = mean.reflectance + mean.transmittance;
        square += all * all;
    }
    const glm::dvec3 all = albedo.reflectance + albedo.transmittance;
    const glm::dvec3 variance = (square - all * all * double(blocks)) / double(blocks * (blocks - 1));
    albedo.standard_error = std::sqrt(std::max({variance.x, variance.y, variance.z, 0.0}));
    return albedo;
}

} // namespace selvedge
