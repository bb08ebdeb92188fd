// Names and numbers of the pictures of a sequence.
#include "reference/sequence.hpp"

#include <cstdio>
#include <filesystem>

#include "bake/error.hpp"

namespace selvedge
{

namespace
{

constexpr int frame_limit = 999999;

// Where "{frame}" or "{frame:N}" begins in text, and its length and N (0 without); false: nowhere.
bool find_frame(const std::string& text, std::size_t& at, std::size_t& length, int& digits)
{
    for (at = text.find("{frame"); at != std::string::npos; at = text.find("{frame", at + 1)) {
        digits = 0;
        length = 7;
        if (text.compare(at + 6, 1, "}") == 0) return true;
        length = 9;
        if (at + 8 < text.size() && text[at + 6] == ':' && text[at + 7] >= '1' && text[at + 7] <= '9' &&
            text[at + 8] == '}') {
            digits = text[at + 7] - '0';
            return true;
        }
    }
    return false;
}

bool names_frame(const Overrides& overrides)
{
    std::size_t at, length;
    int digits;
    for (const std::string& text : overrides)
        if (find_frame(text, at, length, digits)) return true;
    return false;
}

} // namespace

Sequence parse_sequence(int turntable, const std::string& turn, const std::string& frames, const Overrides& overrides)
{
    Sequence sequence;
    sequence.turntable = turntable;
    if (turn == "camera")
        sequence.turned = Turned::camera;
    else if (turn == "lights")
        sequence.turned = Turned::lights;
    else if (!turn.empty() && turn != "objects")
        throw UsageError("--turn: found '%s', expected one of objects, camera, lights", turn.c_str());
    if (!turn.empty() && turntable == 0) throw UsageError("--turn without --turntable, which says how far");
    if (turntable > 0) sequence.last = turntable - 1;
    if (!frames.empty()) {
        int first = 0, last = 0, end = 0;
        const char* text = frames.c_str();
        const bool digits = frames.find_first_not_of("0123456789-") == std::string::npos && frames.size() < 16;
        if (!digits || std::sscanf(text, "%d-%d%n", &first, &last, &end) != 2 || text[end] != '\0' || first < 0 ||
            last < first || last > frame_limit)
            throw UsageError("--frames: found '%s', expected FIRST-LAST, 0 to %d", text, frame_limit);
        if (turntable > 0 && last >= turntable)
            throw UsageError("--frames: found '%s', expected frames 0 to %d of the turntable", text, turntable - 1);
        if (turntable == 0 && !names_frame(overrides))
            throw UsageError(
                "--frames without --turntable or a -D whose value holds {frame}: all frames would be alike");
        sequence.first = first, sequence.last = last;
    }
    if (!sequence.any() && names_frame(overrides)) throw UsageError("-D with {frame} without --frames FIRST-LAST");
    return sequence;
}

std::string frame_path(const std::string& path, int frame)
{
    const std::filesystem::path whole(path);
    const std::string name = whole.stem().string() + format_text("_%04d", frame) + whole.extension().string();
    return (whole.parent_path() / name).string();
}

Overrides frame_overrides(const Overrides& overrides, int frame)
{
    Overrides result = overrides;
    std::size_t at, length;
    int digits;
    for (std::string& text : result)
        while (find_frame(text, at, length, digits)) text.replace(at, length, format_text("%0*d", digits, frame));
    return result;
}

} // namespace selvedge
