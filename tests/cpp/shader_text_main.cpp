// selvedge-shader-text FOLDER NAME: prints what the preview's loader makes of a shader with includes. For the tests
// only.
#include <cstdio>

#include "app/preview/shader_source.hpp"
#include "bake/program.hpp"

int main(int argc, char** argv)
{
    return selvedge::run_program("selvedge-shader-text", [&] {
        if (argc != 3) return 2;
        const selvedge::ShaderText shader = selvedge::load_shader(argv[1], argv[2]);
        std::fputs(shader.text.c_str(), stdout);
        for (const std::string& file : shader.files) std::fprintf(stdout, "\n// file %s", file.c_str());
        return 0;
    });
}
