// selvedge-turns: what a model costs beside another on one scene. All of them are loaded into one process and draw in
// turn, a few milliseconds each, so that whatever else the machine does falls on all alike. The suites ingredients and
// preview run it.
//   selvedge-turns SCENE --renderer reference|preview --model NAME:KEY=VALUE,...   the first model is what the others
//                                                                                  are held to
// A key is one of a scene's model object, or of the preview: keep (a part that is not left out, or all), glsl (folder
// of its shaders), shade (fragment or compute).
// JSON on stdout. Exit 0 done, 1 input failed, 2 wrong usage.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <tbb/global_control.h>

#include "app/preview/context.hpp"
#include "app/preview/preview.hpp"
#include "bake/error.hpp"
#include "bake/program.hpp"
#include "reference/integrator.hpp"

namespace
{

using namespace selvedge;

struct Options {
    std::string scene, renderer = "reference", backend = "egl";
    std::vector<std::string> models;
    int side = 256, rounds = 40;
};

// A model's own scene, drawn by one renderer.
class Turn
{
  public:
    virtual ~Turn() = default;
    virtual void draw() = 0; // one sample of every pixel, finished on return
};

class ReferenceTurn : public Turn
{
  public:
    explicit ReferenceTurn(const Scene& scene, int side)
        : rays(scene), renderer(scene, rays, settings_of(side)), state(renderer.start())
    {
    }
    void draw() override { renderer.add_samples(state, 1); }

  private:
    static RenderSettings settings_of(int side)
    {
        RenderSettings settings;
        settings.integrator = Integrator::direct;
        settings.resolution = {side, side};
        settings.region = {0, 0, side, side};
        return settings;
    }
    RayScene rays;
    Renderer renderer;
    RenderState state;
};

class PreviewTurn : public Turn
{
  public:
    PreviewTurn(const Scene& scene, const GlInfo& info, int side, const PreviewOptions& options)
        : preview(scene, info, {side, side}, options)
    {
    }
    void draw() override
    {
        preview.draw_frame();
        gl.Finish();
    }

  private:
    Preview preview;
};

double quantile(std::vector<double> values, double q)
{
    std::sort(values.begin(), values.end());
    return values[static_cast<std::size_t>(q * static_cast<double>(values.size() - 1) + 0.5)];
}

struct Model {
    std::string name;
    Overrides overrides; // of the scene
    PreviewOptions preview;
    std::string glsl; // folder; empty: the usual one
};

// Of "NAME:KEY=VALUE,..."
Model parse_model(const std::string& text)
{
    Model model;
    const std::size_t colon = std::min(text.find(':'), text.size());
    model.name = text.substr(0, colon);
    std::string settings = text.substr(std::min(colon + 1, text.size()));
    while (!settings.empty()) {
        const std::size_t end = std::min(settings.find(','), settings.size());
        const std::string setting = settings.substr(0, end);
        const std::string value = setting.substr(std::min(setting.find('='), setting.size() - 1) + 1);
        if (setting.starts_with("keep=")) {
            if (value == "all")
                model.preview.kept.insert(skip_names().begin(), skip_names().end());
            else
                model.preview.kept.insert(value);
        } else if (setting.starts_with("glsl=")) {
            model.glsl = value;
        } else if (setting.starts_with("shade=")) {
            if (value != "fragment" && value != "compute")
                throw UsageError("--model: shade=%s, expected fragment or compute", value.c_str());
            model.preview.shading = value == "compute" ? Shading::compute : Shading::fragment;
        } else {
            model.overrides.push_back(std::string("model.") + setting);
        }
        settings.erase(0, end + 1);
    }
    return model;
}

nlohmann::json measure(const Options& options)
{
    // One thread in the reference; software GL has its own, which no model gets more of than another.
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 1);
    const bool preview = options.renderer == "preview";
    const auto context = preview ? Context::create(parse_backend(options.backend)) : nullptr;
    std::vector<std::unique_ptr<Scene>> scenes;
    std::vector<std::unique_ptr<Turn>> turns;
    std::vector<Model> models;
    const char* named = std::getenv("SELVEDGE_GLSL");
    const std::string usual_glsl = named ? named : "";
    for (const std::string& text : options.models) {
        models.push_back(parse_model(text));
        const Model& model = models.back();
        const std::string& glsl = model.glsl.empty() ? usual_glsl : model.glsl;
        if (glsl.empty())
            unsetenv("SELVEDGE_GLSL");
        else
            setenv("SELVEDGE_GLSL", glsl.c_str(), 1);
        scenes.push_back(std::make_unique<Scene>(load_scene(options.scene, model.overrides)));
        if (preview)
            turns.push_back(std::make_unique<PreviewTurn>(*scenes.back(), context->info, options.side, model.preview));
        else
            turns.push_back(std::make_unique<ReferenceTurn>(*scenes.back(), options.side));
        turns.back()->draw(); // compiles, fills caches
    }
    // Each round goes through all models, every other one backwards, and gives one ratio a model.
    const std::size_t count = turns.size();
    const double samples = double(options.side) * options.side;
    std::vector<std::vector<double>> nanoseconds(count);
    for (int round = 0; round < options.rounds; ++round)
        for (std::size_t k = 0; k < count; ++k) {
            const std::size_t turn = round % 2 ? count - 1 - k : k;
            const auto start = std::chrono::steady_clock::now();
            turns[turn]->draw();
            const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - start;
            nanoseconds[turn].push_back(spent.count() * 1e9 / samples);
        }
    nlohmann::json rows = nlohmann::json::array();
    for (std::size_t k = 0; k < count; ++k) {
        std::vector<double> ratios;
        for (std::size_t round = 0; round < nanoseconds[k].size(); ++round)
            ratios.push_back(nanoseconds[k][round] / nanoseconds[0][round]);
        // Of a median: the ranks n/2 -+ 0.98 sqrt(n) hold it with 95 % confidence, whatever the distribution.
        const double reach = 0.98 / std::sqrt(double(options.rounds));
        rows.push_back({{"model", models[k].name},
                        {"nanoseconds", quantile(nanoseconds[k], 0.5)},
                        {"over_first", quantile(ratios, 0.5)},
                        {"low", quantile(ratios, std::max(0.5 - reach, 0.0))},
                        {"high", quantile(ratios, std::min(0.5 + reach, 1.0))}});
    }
    nlohmann::json report = {{"renderer", options.renderer},
                             {"resolution", {options.side, options.side}},
                             {"rounds", options.rounds},
                             {"models", rows}};
    if (preview) {
        report["gl"] = context->info.renderer + ", " + context->info.version + ", " + context->backend;
        report["software"] = context->info.software;
    }
    return report;
}

int run(int argc, char** argv)
{
    Options options;
    CLI::App app("What models cost beside each other, in one process and in turn.", "selvedge-turns");
    bool json = true; // as the other programs have it; here there is nothing else
    app.add_flag("--json", json, "the default");
    app.add_option("scene", options.scene, "SCENE.json")->required();
    app.add_option("--renderer", options.renderer)->check(CLI::IsMember({"reference", "preview"}));
    app.add_option("--backend", options.backend)->check(CLI::IsMember({"egl", "osmesa"}));
    app.add_option("--model", options.models, "NAME:KEY=VALUE,... as in a scene's model object")
        ->required()
        ->allow_extra_args(false);
    app.add_option("--side", options.side, "pixels along each side")->check(CLI::Range(16, 4096));
    app.add_option("--rounds", options.rounds)->check(CLI::Range(2, 100000));
    if (!parse_command_line(app, argc, argv)) return 0;
    std::printf("%s\n", measure(options).dump(1).c_str());
    return 0;
}

} // namespace

int main(int argc, char** argv)
{
    return selvedge::run_program("selvedge-turns", [&] { return run(argc, argv); });
}
