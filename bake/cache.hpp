// bake/cache.hpp: baked fabrics on disk, named by the hash of what they were made from.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "knit_yarns.hpp"
#include "pack.hpp"
#include "ply.hpp"

namespace selvedge
{

// 128-bit FNV-1a over bytes, values and texts.
class ContentHash
{
  public:
    void bytes(const void* data, std::size_t size);
    void text(const std::string& value);
    void number(std::int64_t value) { bytes(&value, sizeof value); }
    void number(float value) { bytes(&value, sizeof value); }
    std::array<std::uint64_t, 2> words() const { return {high, low}; }
    std::string hex() const;

  private:
    std::uint64_t high = 0x6c62272e07bb0142u, low = 0x62b821756295c58du;
};

// Hash of everything that the maps depend on: pattern, yarn geometry, texels, format version. The kind of visibility is
// not among it, nor are albedo, roughness, optical thickness and fibre twist.
std::string geometry_hash(const Fabric& fabric, const WovenPlan& plan);
std::string geometry_hash(const Fabric& fabric, const KnitPlan& plan);

// $SELVEDGE_CACHE, else $XDG_CACHE_HOME/selvedge, else $HOME/.cache/selvedge, else a folder in /tmp.
std::string cache_folder();

// The two parts of a bake, a file each: HASH.maps (texels, heights, horizons, mips, cover, and what the bake warned of)
// and HASH.KIND (what a kind of visibility other than horizon8 adds).
enum class CachePart { maps, visibility };

// Reads a part into `fabric`. False where there is none or it is damaged, of another version or another size: it will
// be baked again. Never throws for what lies in the cache.
//   warnings    maps only: what the bake warned of
//   disk_bytes  grows by the size of the file
bool read_cache(CachePart part, const std::string& hash, PackedFabric& fabric, std::vector<std::string>& warnings,
                std::size_t& disk_bytes);

// Writes it, atomically; returns its size, 0 where the folder cannot be written (which is no error).
std::size_t write_cache(CachePart part, const std::string& hash, const PackedFabric& fabric,
                        const std::vector<std::string>& warnings);

} // namespace selvedge
