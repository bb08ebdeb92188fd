// bake/cache.cpp: hashing, reading and writing of baked fabrics.
#include "cache.hpp"

#include <cstdlib>
#include <cstring>
#include <exception>
#include <filesystem>

#include "error.hpp"
#include "image.hpp"

namespace selvedge
{

namespace
{

// Raise it when the words of a bake change for the same inputs.
constexpr std::uint32_t format_version = 3;
constexpr char magic[8] = {'s', 'e', 'l', 'v', 'b', 'a', 'k', 'e'};

struct Header {
    char magic[8];
    std::uint32_t version;
    std::int32_t width, height;
    std::uint32_t has_gaps;
    float tile_m[2], cover[3], height_range_m[2];
    std::uint64_t counts[2][4]; // texels, horizons, mips, heights of each side
    std::uint64_t payload_bytes;
    std::uint64_t check[2]; // hash of the payload
};

__extension__ using Wide = unsigned __int128;

template <class Packed, class Visit> void each_array(Packed& fabric, Visit&& visit) // Packed may be const
{
    for (int s = 0; s < 2; ++s) {
        visit(s, 0, fabric.side[s].texels);
        visit(s, 1, fabric.side[s].horizons);
        visit(s, 2, fabric.side[s].slope_mips);
        visit(s, 3, fabric.side[s].heights_m);
    }
}

} // namespace

void ContentHash::bytes(const void* data, std::size_t size)
{
    Wide hash = static_cast<Wide>(high) << 64 | low;
    const Wide prime = static_cast<Wide>(0x0000000001000000u) << 64 | 0x13bu;
    const auto* byte = static_cast<const unsigned char*>(data);
    for (std::size_t i = 0; i < size; ++i) {
        hash ^= byte[i];
        hash *= prime;
    }
    high = static_cast<std::uint64_t>(hash >> 64);
    low = static_cast<std::uint64_t>(hash);
}

void ContentHash::text(const std::string& value)
{
    number(static_cast<std::int64_t>(value.size()));
    bytes(value.data(), value.size());
}

std::string ContentHash::hex() const
{
    return format_text("%016llx%016llx", static_cast<unsigned long long>(high), static_cast<unsigned long long>(low));
}

std::string geometry_hash(const Fabric& fabric, const WovenPlan& plan, VisibilityKind visibility)
{
    ContentHash hash;
    hash.number(std::int64_t(format_version));
    hash.number(std::int64_t(plan.size.x));
    hash.number(std::int64_t(plan.size.y));
    hash.number(std::int64_t(visibility));
    hash.bytes(plan.repeat.warp_up.data(), plan.repeat.warp_up.size());
    for (const auto* types : {&plan.end_type, &plan.pick_type}) {
        hash.number(std::int64_t(types->size()));
        hash.bytes(types->data(), types->size() * sizeof(int));
    }
    for (const auto* lengths : {&plan.end_spacing_m, &plan.pick_spacing_m, &plan.end_width_m, &plan.pick_width_m})
        hash.bytes(lengths->data(), lengths->size() * sizeof(float));
    for (const YarnSpec* yarn : {&fabric.warp, &fabric.weft}) {
        hash.number(yarn->aspect);
        hash.number(std::int64_t(yarn->section));
        hash.number(yarn->crimp.value_or(-1.0f));
    }
    for (const int value : {plan.warp_plies, plan.weft_plies, plan.warp_turns, plan.weft_turns})
        hash.number(std::int64_t(value));
    return hash.hex();
}

std::string geometry_hash(const Fabric& fabric, const KnitPlan& plan, VisibilityKind visibility)
{
    ContentHash hash;
    hash.text("knit");
    for (const int value :
         {static_cast<int>(format_version), plan.size.x, plan.size.y, static_cast<int>(visibility),
          plan.pattern.columns, plan.pattern.rows, plan.pattern.rows_per_course, plan.across, plan.up, plan.plies})
        hash.number(std::int64_t(value));
    for (const KnitLoop& loop : plan.pattern.loops) {
        for (const int value : {loop.row, loop.column, loop.face, loop.bed, loop.level, loop.strand})
            hash.number(std::int64_t(value));
        hash.number(std::int64_t(loop.parents.size()));
        hash.bytes(loop.parents.data(), loop.parents.size() * sizeof(KnitParent));
    }
    for (const float value : {plan.wale_m, plan.row_m, plan.loop_m, plan.width_m, fabric.weft.aspect,
                              plan.plies > 1 ? fabric.weft.ply_twist_deg : 0.0f})
        hash.number(value);
    return hash.hex();
}

std::string cache_folder()
{
    const auto variable = [](const char* name) {
        const char* value = std::getenv(name);
        return std::string(value ? value : "");
    };
    if (const std::string own = variable("SELVEDGE_CACHE"); !own.empty()) return own;
    if (const std::string xdg = variable("XDG_CACHE_HOME"); !xdg.empty()) return xdg + "/selvedge";
    if (const std::string home = variable("HOME"); !home.empty()) return home + "/.cache/selvedge";
    return "/tmp/selvedge-cache";
}

bool read_cache(const std::string& hash, PackedFabric& fabric, std::size_t* disk_bytes)
try {
    const std::string path = cache_folder() + "/" + hash + ".bake";
    std::error_code error;
    if (!std::filesystem::exists(path, error)) return false;
    const std::string bytes = read_file(path);
    Header header;
    if (bytes.size() < sizeof header) return false;
    std::memcpy(&header, bytes.data(), sizeof header);
    if (std::memcmp(header.magic, magic, sizeof magic) != 0 || header.version != format_version ||
        header.payload_bytes != bytes.size() - sizeof header || header.width != fabric.size.x ||
        header.height != fabric.size.y)
        return false;
    ContentHash check;
    check.bytes(bytes.data() + sizeof header, bytes.size() - sizeof header);
    if (check.hex() != format_text("%016llx%016llx", static_cast<unsigned long long>(header.check[0]),
                                   static_cast<unsigned long long>(header.check[1])))
        return false;

    PackedFabric found = fabric;
    std::size_t offset = sizeof header;
    bool whole = true;
    each_array(found, [&](int s, int a, auto& array) {
        const std::uint64_t count = header.counts[s][a];
        const std::size_t left = (bytes.size() - offset) / sizeof array[0];
        if (count > left) {
            whole = false;
            return;
        }
        array.resize(count);
        std::memcpy(array.data(), bytes.data() + offset, count * sizeof array[0]);
        offset += count * sizeof array[0];
    });
    const std::size_t texels = static_cast<std::size_t>(fabric.size.x) * static_cast<std::size_t>(fabric.size.y);
    for (const PackedSide& side : found.side)
        whole = whole && side.texels.size() == texels && side.horizons.size() * 4 == texels &&
                side.heights_m.size() == texels &&
                side.slope_mips.size() == slope_level_offset(fabric.size, slope_level_count(fabric.size));
    if (!whole || offset != bytes.size()) return false;
    found.tile_m = {header.tile_m[0], header.tile_m[1]};
    found.has_gaps = header.has_gaps != 0;
    found.warp_cover = header.cover[0], found.weft_cover = header.cover[1], found.gap_cover = header.cover[2];
    found.height_range_m = {header.height_range_m[0], header.height_range_m[1]};
    fabric = std::move(found);
    if (disk_bytes) *disk_bytes = bytes.size();
    return true;
} catch (const std::exception&) {
    return false; // unreadable: as good as absent
}

std::size_t write_cache(const std::string& hash, const PackedFabric& fabric)
try {
    Header header{};
    std::memcpy(header.magic, magic, sizeof magic);
    header.version = format_version;
    header.width = fabric.size.x, header.height = fabric.size.y;
    header.has_gaps = fabric.has_gaps ? 1 : 0;
    header.tile_m[0] = fabric.tile_m.x, header.tile_m[1] = fabric.tile_m.y;
    header.cover[0] = fabric.warp_cover, header.cover[1] = fabric.weft_cover, header.cover[2] = fabric.gap_cover;
    header.height_range_m[0] = fabric.height_range_m.x, header.height_range_m[1] = fabric.height_range_m.y;
    std::string bytes(sizeof header, '\0'); // the header's place
    each_array(fabric, [&](int side, int array_index, const auto& array) {
        header.counts[side][array_index] = array.size();
        bytes.append(reinterpret_cast<const char*>(array.data()), array.size() * sizeof array[0]);
    });
    header.payload_bytes = bytes.size() - sizeof header;
    ContentHash check;
    check.bytes(bytes.data() + sizeof header, header.payload_bytes);
    const std::string hex = check.hex();
    header.check[0] = std::stoull(hex.substr(0, 16), nullptr, 16);
    header.check[1] = std::stoull(hex.substr(16), nullptr, 16);
    std::memcpy(bytes.data(), &header, sizeof header);

    const std::string folder = cache_folder();
    std::filesystem::create_directories(folder);
    write_file(folder + "/" + hash + ".bake", bytes.data(), bytes.size());
    return bytes.size();
} catch (const std::exception&) {
    return 0; // a read-only home must not stop a render
}

} // namespace selvedge
