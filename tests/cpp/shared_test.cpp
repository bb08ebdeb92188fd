// The shared source as C++: what only C++ can see of it. Values and samplers are tested from Python, in all builds at
// once (test_shared_functions.py, test_sampling.py).
#include <catch2/catch.hpp>

#include <type_traits>
#include <vector>

#include "cloth_bsdf.hpp"

// A second file that includes the door: a shared function that is not inline would not link.
double sigma_of_the_other_file(glm::dvec3 w, glm::dvec3 t, double alpha);

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
