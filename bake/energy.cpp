// bake/energy.cpp: quadrature over the shared slab functions; fits of math.md 9.2.
#include "energy.hpp"

#include <algorithm>
#include <cmath>

namespace selvedge
{

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

float mean_slab_reflectance(float alpha, float thickness)
{
    constexpr int steps = 6;
    double sum = 0;
    for (int a = 0; a < steps; ++a)
        for (int b = 0; b < steps; ++b)
            sum += slab_albedo(double(alpha), double(alpha), double(thickness), std::sqrt((a + 0.5) / steps),
                               std::sin((b + 0.5) / steps * 1.5707963267948966))
                       .x;
    return float(sum / (steps * steps));
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

YarnEnergy yarn_energy(const cloth::f32::ClothYarn& yarn, bool unscattered)
{
    YarnEnergy worst;
    constexpr int angles = 8, turns = 3;
    for (int a = 0; a < angles; ++a)
        for (int b = 0; b < turns; ++b) {
            const double angle = 89.0 * a / (angles - 1);
            const glm::dvec3 albedo = slab_albedo(double(yarn.alpha_r), double(yarn.alpha_t), double(yarn.thickness),
                                                  std::cos(angle / 57.29577951308232), double(b) / (turns - 1));
            for (int c = 0; c < 3; ++c) {
                const double slab = double(yarn.albedo_r[c]) * albedo.x + double(yarn.albedo_t[c]) * albedo.y;
                const double diffuse = double(yarn.diffuse_r[c]) + double(yarn.diffuse_t[c]);
                const double through = unscattered ? albedo.z : 0;
                if (slab + diffuse + through > worst.most)
                    worst = {slab + diffuse + through, angle, c, slab, diffuse, through};
            }
        }
    return worst;
}

} // namespace selvedge
