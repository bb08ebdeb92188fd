// The presets of the model by name, and that a report states what was asked for.
#include <catch2/catch.hpp>

#include "bake/energy.hpp"
#include "bake/error.hpp"
#include "reference/model.hpp"

namespace selvedge
{

namespace f32 = cloth::f32;

TEST_CASE("presets of the model")
{
    const ModelSpec ours = model_preset("ours"), paper = model_preset("paper"), jin = model_preset("jin");
    CHECK(ours.settings.weight == f32::cloth_weight_relief);
    CHECK(ours.settings.visibility == f32::cloth_visibility_horizon8);
    CHECK((ours.settings.unscattered && ours.settings.interreflection && ours.stacked));
    CHECK(paper.settings.bsdf == f32::cloth_bsdf_meso);
    CHECK(paper.settings.weight == f32::cloth_weight_mips);
    CHECK(paper.settings.visibility == f32::cloth_visibility_asg);
    CHECK(paper.visibility == VisibilityKind::asg);
    CHECK_FALSE((paper.settings.unscattered || paper.settings.interreflection || paper.stacked));
    // Jin et al. 2022: the slab of the macroscopic normal, nothing between the yarns (math.md 3.5).
    CHECK(jin.settings.bsdf == f32::cloth_bsdf_micro);
    CHECK(jin.settings.slab == f32::cloth_slab_macro);
    CHECK(jin.settings.visibility == f32::cloth_visibility_none);
    CHECK_FALSE((jin.settings.unscattered || jin.settings.interreflection || jin.stacked));
}

TEST_CASE("a model's JSON gives the model back")
{
    for (const char* mode : {"ours", "paper", "jin"}) {
        const nlohmann::json json = model_json(model_preset(mode));
        CHECK(model_json(parse_model(JsonValue::parse(json.dump(), "model.json"))) == json);
        CHECK(model_json(parse_model(JsonValue::parse(nlohmann::json{{"mode", mode}}.dump(), "model.json"))) == json);
    }
    for (const char* word : {"horizon8", "horizon16", "cap", "asg", "asg-lsq", "exact", "none"}) {
        const ModelSpec model =
            parse_model(JsonValue::parse(nlohmann::json{{"visibility", word}}.dump(), "model.json"));
        CHECK(model_json(model)["visibility"] == word);
        const bool none = std::string(word) == "none";
        CHECK(model.settings.visibility == (none ? f32::cloth_visibility_none : visibility_lookup(model.visibility)));
        if (!none) CHECK(std::string(visibility_name(model.visibility)) == word);
    }
    CHECK_THROWS_AS(parse_model(JsonValue::parse(R"({"mode": "jim"})", "model.json")), InputError);
    CHECK_THROWS_AS(parse_model(JsonValue::parse(R"({"visibility": "exakt"})", "model.json")), InputError);
}

} // namespace selvedge
