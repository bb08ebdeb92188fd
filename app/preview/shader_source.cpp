// app/preview/shader_source.cpp: include loader, readable compiler logs, programs that reload.
#include "app/preview/shader_source.hpp"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <regex>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "app/preview/program_cache.hpp"
#include "bake/error.hpp"

namespace selvedge
{
namespace fs = std::filesystem;

fs::path glsl_folder()
{
    std::vector<fs::path> folders;
    if (const char* named = std::getenv("SELVEDGE_GLSL")) folders.emplace_back(named);
    folders.emplace_back(SELVEDGE_GLSL_SOURCE);
    std::error_code ignored;
    const fs::path program = fs::read_symlink("/proc/self/exe", ignored);
    if (!program.empty()) folders.push_back(program.parent_path().parent_path() / "share/selvedge/glsl");
    folders.emplace_back(SELVEDGE_GLSL_INSTALLED);
    std::string looked;
    for (const fs::path& folder : folders) {
        if (fs::exists(folder / "cloth.h", ignored)) return folder;
        looked += (looked.empty() ? "" : ", ") + folder.string();
    }
    throw InputError("cloth.h", 0, "not found, expected in one of: %s (set SELVEDGE_GLSL)", looked.c_str());
}

// ---- includes ----------------------------------------------------------------------------------------------------

FileStamp FileStamp::of(const fs::path& file)
{
    std::error_code no_file; // a file that is not there has a stamp, too
    return {file, fs::last_write_time(file, no_file), fs::file_size(file, no_file)};
}

static void paste(const fs::path& folder, const std::string& name, const std::string& from, int from_line,
                  std::vector<std::string>& open, ShaderText& shader)
{
    if (std::find(open.begin(), open.end(), name) != open.end())
        throw InputError(from, from_line, "%s includes itself", name.c_str());
    const FileStamp stamp = FileStamp::of(folder / name);
    std::ifstream file(folder / name);
    if (!file) throw InputError(from, from_line, "shader %s not found in %s", name.c_str(), folder.c_str());
    const std::size_t index = shader.files.size();
    shader.files.push_back(name);
    shader.stamps.push_back(stamp);
    open.push_back(name);
    shader.text += format_text("#line 1 %zu\n", index);
    static const std::regex include("\\s*#include \"([^\"]+)\".*");
    std::smatch match;
    std::string line;
    for (int number = 1; std::getline(file, line); ++number) {
        if (!std::regex_match(line, match, include)) {
            shader.text += line + "\n";
            continue;
        }
        paste(folder, match[1], name, number, open, shader);
        shader.text += format_text("#line %d %zu\n", number + 1, index);
    }
    open.pop_back();
}

ShaderText load_shader(const fs::path& folder, const std::string& name)
{
    ShaderText shader;
    std::vector<std::string> open;
    paste(folder, name, "", 0, open, shader);
    return shader;
}

std::string readable_log(const std::string& log, const std::vector<std::string>& files)
{
    // Mesa writes file:line(column), NVIDIA file(line), others ERROR: file:line:.
    static const std::regex place("(\\d+)(?::(\\d+)\\(\\d+\\)|\\((\\d+)\\)|:(\\d+)(?=:))");
    std::string text;
    auto rest = log.cbegin();
    for (std::smatch match; std::regex_search(rest, log.cend(), match, place);) {
        text.append(rest, match[0].first);
        const std::size_t file = std::strtoul(match[1].str().c_str(), nullptr, 10);
        const std::string line = match[2].matched ? match[2] : match[3].matched ? match[3] : match[4];
        text += file < files.size() ? files[file] + ":" + line : match[0].str();
        rest = match[0].second;
    }
    text.append(rest, log.cend());
    while (!text.empty() && (text.back() == '\n' || text.back() == '\0')) text.pop_back();
    return text;
}

// ---- programs ----------------------------------------------------------------------------------------------------

static std::string log_of(GLuint name, decltype(gl.GetShaderiv) get, decltype(gl.GetShaderInfoLog) get_log)
{
    GLint length = 0;
    get(name, GL_INFO_LOG_LENGTH, &length);
    std::string log(static_cast<std::size_t>(std::max(length, 1)), '\0');
    get_log(name, length, nullptr, log.data());
    return log;
}

struct Stage {
    const char* ending;
    GLenum kind;
    const char* version;
};
static const Stage& stage_of(const std::string& file)
{
    static const Stage stages[] = {{".vert", GL_VERTEX_SHADER, "#version 410 core\n"},
                                   {".frag", GL_FRAGMENT_SHADER, "#version 410 core\n"},
                                   {".comp", GL_COMPUTE_SHADER, "#version 430 core\n"}};
    for (const Stage& stage : stages)
        if (file.ends_with(stage.ending)) return stage;
    throw std::logic_error(file + ": no shader has that ending");
}

ShaderProgram::ShaderProgram(std::vector<std::string> stage_files, std::vector<std::string> with)
    : files(std::move(stage_files)), defines(std::move(with))
{
    start();
}

void ShaderProgram::start()
{
    const fs::path folder = glsl_folder();
    std::vector<ShaderText> texts;
    for (const std::string& file : files) texts.push_back(load_shader(folder, file));
    // Remembered before compiling: a broken file is compiled once, not at every look.
    stamps.clear();
    for (const ShaderText& text : texts) stamps.insert(stamps.end(), text.stamps.begin(), text.stamps.end());

    std::string header;
    for (const std::string& define : defines)
        header += "#define " + define + (define.find(' ') == std::string::npos ? " 1\n" : "\n");
    std::vector<std::string> whole;
    for (std::size_t k = 0; k < files.size(); ++k) whole.push_back(stage_of(files[k]).version + header + texts[k].text);
    Unfinished made{GlName(GlName::Kind::program, gl.CreateProgram()), {}, {}, program_key(whole)};
    if (read_program(made.key, *made.program)) {
        ++program_counts().cached;
    } else {
        made.program = GlName(GlName::Kind::program, gl.CreateProgram());
        gl.ProgramParameteri(*made.program, GL_PROGRAM_BINARY_RETRIEVABLE_HINT, GL_TRUE);
        for (std::size_t k = 0; k < files.size(); ++k) {
            made.shaders.emplace_back(GlName::Kind::shader, gl.CreateShader(stage_of(files[k]).kind));
            made.included.push_back(std::move(texts[k].files));
            const GLuint shader = *made.shaders.back();
            const char* part = whole[k].c_str();
            gl.ShaderSource(shader, 1, &part, nullptr);
            gl.CompileShader(shader);
            gl.AttachShader(*made.program, shader);
        }
        // Nothing is asked before the end: drivers that compile aside would have to be waited for.
        gl.LinkProgram(*made.program);
    }
    unfinished = std::move(made);
}

bool ShaderProgram::is_ready(const GlInfo& info) const
{
    if (!unfinished || unfinished->shaders.empty() || !info.compiles_aside) return true;
    GLint ready = GL_FALSE;
    gl.GetProgramiv(*unfinished->program, GL_COMPLETION_STATUS_KHR, &ready);
    return ready == GL_TRUE;
}

void ShaderProgram::finish()
{
    if (!unfinished) {
        if (!program) throw std::runtime_error(error_text); // it has never been compiled
        return;
    }
    Unfinished made = std::move(*unfinished);
    unfinished.reset();
    if (!made.shaders.empty()) {
        GLint good = GL_FALSE;
        gl.GetProgramiv(*made.program, GL_LINK_STATUS, &good);
        for (std::size_t k = 0; k < files.size() && good != GL_TRUE; ++k) {
            GLint compiled = GL_FALSE;
            gl.GetShaderiv(*made.shaders[k], GL_COMPILE_STATUS, &compiled);
            if (compiled == GL_TRUE) continue;
            const std::string log = log_of(*made.shaders[k], gl.GetShaderiv, gl.GetShaderInfoLog);
            throw std::runtime_error(readable_log(log, made.included[k]));
        }
        if (good != GL_TRUE)
            throw std::runtime_error(files.back() + ": " +
                                     readable_log(log_of(*made.program, gl.GetProgramiv, gl.GetProgramInfoLog), {}));
        ++program_counts().compiled;
        write_program(made.key, *made.program);
    }
    // GLSL 4.1 has no layout(binding = ...).
    gl.UseProgram(*made.program);
    for (const Binding& texture : texture_units)
        gl.Uniform1i(gl.GetUniformLocation(*made.program, texture.name), texture.unit);
    const GLuint block = gl.GetUniformBlockIndex(*made.program, "Frame");
    if (block != GL_INVALID_INDEX) gl.UniformBlockBinding(*made.program, block, 0);
    program = std::move(made.program);
}

bool ShaderProgram::rebuild_if_changed()
{
    const bool changed = std::any_of(stamps.begin(), stamps.end(),
                                     [](const FileStamp& stamp) { return !(FileStamp::of(stamp.file) == stamp); });
    if (!changed) return false;
    try {
        start();
        finish();
        error_text.clear();
        return true;
    } catch (const std::exception& error) {
        error_text = error.what();
        return false;
    }
}

bool ProgramVariants::use(const std::vector<std::string>& defines)
{
    const ShaderProgram* const before = in_use;
    if (!asked_for(defines)) begin(defines);
    finish();
    return in_use != before;
}

void ProgramVariants::use_soon(const std::vector<std::string>& defines, const GlInfo& info)
{
    if (!asked_for(defines)) begin(defines);
    if (compiling() && next->is_ready(info)) finish();
}

bool ProgramVariants::asked_for(const std::vector<std::string>& defines) const
{
    return (in_use != nullptr || compiling()) && wanted == defines;
}

void ProgramVariants::begin(std::vector<std::string> defines)
{
    wanted = std::move(defines);
    next = nullptr;
    try {
        auto found = programs.find(wanted);
        if (found == programs.end())
            found = programs.emplace(wanted, ShaderProgram(files, wanted)).first;
        else
            found->second.rebuild_if_changed(); // its files may have been saved while it was not in use
        next = &found->second;
    } catch (const std::exception& error) {
        fail(error);
    }
}

void ProgramVariants::finish()
{
    if (!compiling()) return;
    try {
        next->finish();
        in_use = std::exchange(next, nullptr);
        error_text.clear();
    } catch (const std::exception& error) {
        next = nullptr;
        programs.erase(wanted);
        fail(error);
    }
}

void ProgramVariants::fail(const std::exception& error)
{
    if (in_use == nullptr) throw;
    error_text = error.what();
}

bool ProgramVariants::rebuild_if_changed()
{
    if (in_use == nullptr) return false;
    // What was asked for and did not compile is tried again with what has been saved since.
    const ShaderProgram* const before = in_use;
    if (!error_text.empty()) {
        begin(wanted);
        finish();
    }
    return in_use->rebuild_if_changed() || in_use != before;
}

GLint texture_unit(const char* name)
{
    for (const Binding& texture : texture_units)
        if (std::strcmp(texture.name, name) == 0) return texture.unit;
    throw std::logic_error(std::string("no texture unit for ") + name);
}

} // namespace selvedge
