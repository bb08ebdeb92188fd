// app/preview/program_cache.cpp: program binaries, written whole or not at all, trusted only with the right checksum.
#include "app/preview/program_cache.hpp"

#include <cstring>
#include <exception>
#include <filesystem>

#include "bake/cache.hpp"
#include "bake/image.hpp"

namespace selvedge
{
namespace
{

constexpr char magic[8] = {'s', 'e', 'l', 'v', 'p', 'r', 'o', '1'};

struct Header {
    char magic[8];
    GLuint format;
    GLuint size;
    char check[32]; // ContentHash of the binary
};

std::string path_of(const std::string& key)
{
    return cache_folder() + "/programs/" + key + ".program";
}

std::string hash_of(const char* bytes, std::size_t size)
{
    ContentHash hash;
    hash.bytes(bytes, size);
    return hash.hex();
}

// A driver may know no format at all (macOS).
bool driver_has_binaries()
{
    GLint formats = 0;
    gl.GetIntegerv(GL_NUM_PROGRAM_BINARY_FORMATS, &formats);
    return formats > 0;
}

} // namespace

ProgramCounts& program_counts()
{
    static ProgramCounts counts;
    return counts;
}

std::string program_key(const std::vector<std::string>& stage_texts)
{
    ContentHash hash;
    for (const GLenum what : {GL_VENDOR, GL_RENDERER, GL_VERSION, GL_SHADING_LANGUAGE_VERSION}) {
        const GLubyte* text = gl.GetString(what);
        hash.text(text != nullptr ? reinterpret_cast<const char*>(text) : "");
    }
    for (const std::string& text : stage_texts) hash.text(text);
    return hash.hex();
}

bool read_program(const std::string& key, GLuint program)
try {
    const std::string path = path_of(key);
    std::error_code error;
    if (!driver_has_binaries() || !std::filesystem::exists(path, error)) return false;
    const std::string bytes = read_file(path);
    Header header;
    if (bytes.size() < sizeof header) return false;
    std::memcpy(&header, bytes.data(), sizeof header);
    const char* binary = bytes.data() + sizeof header;
    if (std::memcmp(header.magic, magic, sizeof magic) != 0 || header.size != bytes.size() - sizeof header ||
        hash_of(binary, header.size) != std::string(header.check, sizeof header.check))
        return false;
    gl.ProgramBinary(program, header.format, binary, static_cast<GLsizei>(header.size));
    GLint good = GL_FALSE;
    gl.GetProgramiv(program, GL_LINK_STATUS, &good);
    while (gl.GetError() == GL_INVALID_ENUM) // a format of another driver version
        ;
    return good == GL_TRUE;
} catch (const std::exception&) {
    return false; // unreadable: as good as absent
}

void write_program(const std::string& key, GLuint program)
try {
    GLint size = 0;
    if (!driver_has_binaries()) return;
    gl.GetProgramiv(program, GL_PROGRAM_BINARY_LENGTH, &size);
    if (size <= 0) return;
    Header header{};
    std::string bytes(sizeof header + static_cast<std::size_t>(size), '\0');
    GLsizei written = 0;
    gl.GetProgramBinary(program, size, &written, &header.format, bytes.data() + sizeof header);
    if (gl.GetError() != GL_NO_ERROR || written <= 0) return;
    bytes.resize(sizeof header + static_cast<std::size_t>(written));
    std::memcpy(header.magic, magic, sizeof magic);
    header.size = static_cast<GLuint>(written);
    const std::string check = hash_of(bytes.data() + sizeof header, static_cast<std::size_t>(written));
    check.copy(header.check, sizeof header.check);
    std::memcpy(bytes.data(), &header, sizeof header);
    std::filesystem::create_directories(cache_folder() + "/programs");
    write_file(path_of(key), bytes.data(), bytes.size());
} catch (const std::exception&) {
    // A read-only home must not stop a picture.
}

} // namespace selvedge
