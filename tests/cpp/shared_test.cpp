// The shared source as C++: what only C++ can see of it. Values and samplers are tested from Python, in all builds at
// once (test_shared_functions.py, test_sampling.py).
#include <catch2/catch.hpp>

#include <cmath>
#include <numbers>
#include <random>
#include <type_traits>
#include <vector>

#include "cloth_bsdf.hpp"

// A second file that includes the door: a shared function that is not inline would not link.
double sigma_of_the_other_file(glm::dvec3 w, glm::dvec3 t, double alpha);

TEST_CASE("the arc tangent of the shared source is that of the C library", "[shared]")
{
    using cloth::atan;
    double worst = 0;
    for (int k = 0; k < 200000; ++k) {
        const double angle = ((k + 0.5) / 100000 - 1) * std::numbers::pi, length = std::exp2(k % 121 - 60);
        const float y = float(length * std::sin(angle)), x = float(length * std::cos(angle));
        worst = std::max(worst, std::abs(double(atan(y, x)) - std::atan2(double(y), double(x))));
    }
    CHECK(worst < 4e-7); // an ulp and a half of pi
    for (const float x : {-2.0f, -0.0f, 0.0f, 2.0f})
        for (const float y : {-3.0f, -0.0f, 0.0f, 3.0f})
            if (x != 0 || y != 0) CHECK(atan(y, x) == Approx(std::atan2(y, x)).margin(1e-7));
    CHECK(atan(0.0f, 0.0f) == 0.0f);
}

TEST_CASE("two files share the source", "[shared]")
{
    const glm::dvec3 w = glm::normalize(glm::dvec3(-0.2, 0.5, 0.7)), t = glm::normalize(glm::dvec3(1, 0.2, 0.1));
    CHECK(sigma_of_the_other_file(w, t, 0.2) == cloth::f64::cloth_sggx_sigma(w, t, 0.2));
    CHECK(cloth::f64::cloth_sggx_sigma(w, t, 0.2) == Approx(0.999472388285467).epsilon(1e-14));
}

TEST_CASE("float stays float", "[shared]")
{
    // A stray double literal would make the C++ figures better than the shader's.
    STATIC_REQUIRE(std::is_same_v<decltype(cloth::f32::cloth_phi1(0.5f)), float>);
    STATIC_REQUIRE(std::is_same_v<decltype(cloth::f64::cloth_phi1(0.5)), double>);
    STATIC_REQUIRE(std::is_same_v<decltype(cloth::f32::ClothPoint::length_f), float>);
    STATIC_REQUIRE(std::is_same_v<decltype(cloth::f64::ClothPoint::length_f), double>);
}

TEST_CASE("bits are reversed and multiplied as the shader does", "[shared]")
{
    CHECK(cloth::cloth_reverse_bits(1u) == 0x80000000u);
    CHECK(cloth::cloth_reverse_bits(0x12345678u) == 0x1e6a2c48u);
    CHECK(cloth::cloth_multiply_high(0xffffffffu, 0xffffffffu) == 0xfffffffeu);
    CHECK(cloth::cloth_multiply_high(0x80000000u, 6u) == 3u);
}

TEST_CASE("a long run of samples loses none of its weight", "[shared]")
{
    // Block means of 65,536 samples, as both renderers average them: the float sum of each block of 64 is exact enough.
    const unsigned length = cloth::f32::cloth_block_length(65536u);
    double whole = 0, exact = 0;
    unsigned blocks = 0;
    for (unsigned block = 0; block * length < 65536u; ++block, ++blocks) {
        float sum = 0;
        for (unsigned k = 0; k < length; ++k) {
            const float value = cloth::f32::cloth_random(block, k, 0u).x;
            sum += value;
            exact += static_cast<double>(value);
        }
        whole += static_cast<double>(sum / static_cast<float>(length));
    }
    CHECK(whole / blocks == Approx(exact / 65536.0).epsilon(1e-6));
}

TEST_CASE("samples of a shaded point give the integral of its value, light between yarns included", "[shared]")
{
    using namespace cloth::f64;
    // A steep ply in a furrow. Without specular lobes no lobe of the point reaches what lies behind the ply: that part
    // of the light between the yarns is found by its own lobe or not at all.
    ClothMaps maps;
    ClothSettings settings{
        cloth_bsdf_meso, cloth_weight_relief, cloth_visibility_none, cloth_slab_ply, true, true, false};
    ClothSelection selection{};
    const glm::dvec3 area(-1.5, 0.4, 1);
    selection.weight = 1;
    const glm::dvec3 fibre(0, 1, 0);
    selection.texel.point = {glm::normalize(area), glm::normalize(area), fibre, fibre,
                             glm::length(area),    glm::length(area)};
    selection.texel.openness_f = 0.4;
    selection.texel.openness_b = 0.3;
    selection.yarn = {glm::dvec3(0),
                      glm::dvec3(0),
                      glm::dvec3(0.6),
                      glm::dvec3(0.2),
                      0.2,
                      0.2,
                      2,
                      glm::dvec2(1, 0),
                      1,
                      glm::dvec3(0.6),
                      glm::dvec3(0.3),
                      glm::dvec3(0.95),
                      0,
                      2};
    const glm::dvec3 o = glm::normalize(glm::dvec3(-0.3, 0.1, 0.8));
    for (const double albedo : {0.0, 0.2}) {
        selection.yarn.albedo_r = selection.yarn.albedo_t = glm::dvec3(albedo);
        const ClothShading shading = cloth_shade_fabric(selection, settings);
        double exact = 0;
        constexpr int rows = 512, columns = 1024;
        for (int a = 0; a < rows; ++a)
            for (int b = 0; b < columns; ++b) {
                const double z = 2 * (a + 0.5) / rows - 1, phi = 2 * cloth_pi * (b + 0.5) / columns;
                const glm::dvec3 i(std::sqrt(1 - z * z) * std::cos(phi), std::sqrt(1 - z * z) * std::sin(phi), z);
                exact += cloth_shading_value(maps, shading, i, o, settings).x * 4 * cloth_pi / (rows * columns);
            }
        std::mt19937 random(9);
        std::uniform_real_distribution<double> unit(0, 1);
        double sum = 0, squares = 0;
        constexpr int samples = 200000;
        for (int k = 0; k < samples; ++k) {
            const glm::dvec2 lobe(unit(random), unit(random)), u(unit(random), unit(random));
            const ClothSample s = cloth_shading_sample(shading, o, settings, lobe, u);
            REQUIRE(s.pdf > 0);
            REQUIRE(s.pdf == Approx(cloth_shading_pdf(shading, s.wi, o, settings)).epsilon(1e-9));
            const double weight = cloth_shading_value(maps, shading, s.wi, o, settings).x / s.pdf;
            sum += weight;
            squares += weight * weight;
        }
        const double mean = sum / samples, deviation = std::sqrt((squares / samples - mean * mean) / samples);
        CHECK(std::abs(mean - exact) < 4 * deviation + 1e-4);
        CHECK(deviation * std::sqrt(samples) < 0.6);
    }
}
