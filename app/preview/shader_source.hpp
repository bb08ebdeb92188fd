// app/preview/shader_source.hpp: GLSL files with their includes pasted; programs that survive a broken edit.
#pragma once

#include <cstdint>
#include <exception>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "gl.hpp"

namespace selvedge
{

// The folder of the shaders: $SELVEDGE_GLSL, the source tree, beside the program (../share/selvedge/glsl), where they
// were to be installed; the first that has cloth.h.
//   throws  InputError that names the folders
std::filesystem::path glsl_folder();

// How a file looked just before it was read. The size tells a file that was caught half written from the whole one,
// whose time of change may be the same.
struct FileStamp {
    std::filesystem::path file;
    std::filesystem::file_time_type changed{};
    std::uintmax_t size = 0;

    static FileStamp of(const std::filesystem::path& file);
    bool operator==(const FileStamp&) const = default;
};

struct ShaderText {
    std::string text;
    std::vector<std::string> files; // "#line N i" in the text means files[i]; relative to the folder
    std::vector<FileStamp> stamps;  // of each
};

// folder/name with every `#include "file"` pasted, `#line` kept true. The twin of tests/shader_source.py.
//   throws  InputError file:line: missing file, include of a file that is being included
ShaderText load_shader(const std::filesystem::path& folder, const std::string& name);

// A driver's log with file names: "2:31(8): error" and "2(31) : error" become "cloth_bsdf.h:31: error".
std::string readable_log(const std::string& log, const std::vector<std::string>& files);

// Vertex and fragment shader of the GL 4.1 dialect, or a compute shader of that of 4.3; a file's ending says which it
// is: .vert, .frag, .comp. Uniform blocks and samplers get the units of texture_units.
class ShaderProgram
{
  public:
    // Has the driver begin to compile.
    //   defines  "GAPS" becomes #define GAPS 1
    //   throws   InputError: a file that is missing or includes itself
    ShaderProgram(std::vector<std::string> files, std::vector<std::string> defines = {});

    // Whether finish() would not wait; where the driver cannot say, it will.
    bool is_ready(const GlInfo& info) const;
    // Waits until it is compiled; does nothing the second time.
    //   throws  std::runtime_error with file:line of the shader
    void finish();

    GLuint operator*() const { return *program; }
    GLint location(const char* uniform) const { return gl.GetUniformLocation(*program, uniform); }

    // Compiles anew if a file has changed on disk. Where that fails, the last good program stays, and complaint() says
    // why until it succeeds.
    //   return  true: the program is another one now
    bool rebuild_if_changed();
    const std::string& complaint() const { return error_text; }

  private:
    void start();

    struct Unfinished {
        GlName program;
        std::vector<GlName> shaders;                    // none: the program is from the cache
        std::vector<std::vector<std::string>> included; // files of each shader
        std::string key;                                // in the cache
    };

    std::vector<std::string> files, defines;
    std::optional<Unfinished> unfinished;
    GlName program;
    std::vector<FileStamp> stamps; // of all files that the last attempt has read
    std::string error_text;
};

// The programs of the same files: one for each list of definitions that was asked for, compiled when first used,
// kept for the next time.
class ProgramVariants
{
  public:
    explicit ProgramVariants(std::vector<std::string> stage_files) : files(std::move(stage_files)) {}

    // From now on the program with these definitions is used. Where it does not compile, the one before stays in use,
    // and complaint() says why.
    //   return  true: another program is in use now
    //   throws  InputError or std::runtime_error where there is none before
    bool use(const std::vector<std::string>& defines);
    // Likewise, but waits for no driver that compiles aside: until that is done the one before stays in use, if there
    // is one, and compiling() is true. To be called again.
    void use_soon(const std::vector<std::string>& defines, const GlInfo& info);
    void finish(); // waits for what was asked for last; throws as use()

    ShaderProgram& current() { return *in_use; }
    bool compiling() const { return next != nullptr; }
    bool compiled() const { return error_text.empty() && !compiling(); } // what was asked for is in use
    bool rebuild_if_changed();                                           // as ShaderProgram's, of the program in use
    std::string complaint() const
    {
        return !error_text.empty() || in_use == nullptr ? error_text : in_use->complaint();
    }

  private:
    std::vector<std::string> files;
    std::map<std::vector<std::string>, ShaderProgram> programs;
    ShaderProgram *in_use = nullptr, *next = nullptr; // next: what was asked for, not finished
    std::vector<std::string> wanted;
    std::string error_text; // of `wanted`

    bool asked_for(const std::vector<std::string>& defines) const;
    void begin(std::vector<std::string> defines);
    void fail(const std::exception& error);
};

// Texture units and uniform blocks by name; a name that a program lacks is nothing.
struct Binding {
    const char* name;
    GLint unit;
};
inline constexpr Binding texture_units[] = {
    {"map_words", 0},
    {"slope_words", 1},
    {"yarn_table", 2},
    {"light_table", 3},
    {"environment_map", 4},
    {"inversion_map", 5},
    {"triangle_table", 6},
    {"object_table", 7},
    {"bvh_nodes", 8},
    {"bvh_triangles", 9},
    {"id_map", 10},
    {"block_sum", 11},
    {"mean_map", 12},
    {"spread_map", 13},
    {"rest_map", 14},
    {"carried_map", 15},
    {"past_picture", 0},
    {"past_place", 1},
    // Buffers, on units that other passes use for pictures: a program never has both.
    {"height_words", 11},
    {"asg_table", 12},
    {"tile_base_table", 13},
    {"emitter_table", 14},
    // Of adaptive sampling.
    {"odd_mean_map", 16},
    {"odd_spread_map", 17},
    {"kept_map", 18},
    {"kept_noise_map", 19},
    {"seen_map", 20},
    {"denoised_map", 21},
    {"drawn_tiles", 22},
    {"block_nodes", 23},
};
GLint texture_unit(const char* name);

} // namespace selvedge
