// bake/cache.hpp: baked fabrics on disk, named by the hash of what they were made from.
#pragma once

#include <cstdint>
#include <string>

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
    std::string hex() const;

  private:
    std::uint64_t high = 0x6c62272e07bb0142u, low = 0x62b821756295c58du;
};

// Hash of everything that the baked words depend on: pattern, yarn geometry, texels, visibility, format version.
// Albedo, roughness, optical thickness and fibre twist are not among them.
std::string geometry_hash(const Fabric& fabric, const WovenPlan& plan, VisibilityKind visibility);
std::string geometry_hash(const Fabric& fabric, const KnitPlan& plan, VisibilityKind visibility);

// $SELVEDGE_CACHE, else $XDG_CACHE_HOME/selvedge, else $HOME/.cache/selvedge, else a folder in /tmp.
std::string cache_folder();

// Reads HASH.bake into the geometry part of `fabric` (sides, cover, heights, gaps). False where there is none or it is
// damaged, of another version or another size: it will be baked again. Never throws for what lies in the cache.
bool read_cache(const std::string& hash, PackedFabric& fabric, std::size_t* disk_bytes);

// Writes it, atomically; returns its size, 0 where the folder cannot be written (which is no error).
std::size_t write_cache(const std::string& hash, const PackedFabric& fabric);

} // namespace selvedge
