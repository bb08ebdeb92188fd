// Adaptive sampling: when a tile of the picture has had samples enough. One rule for both renderers; the integrator and
// the preview include it.
//
// Samples go where they lower the mean relMSE of the picture most, and end where it is expected to be below the target
// (adaptive_aim), in tiles each of which stops by itself.
//
// The mean stays unbiased: even and odd blocks of samples are independent halves, and each half's length is decided by
// what the other one has seen alone. With v a tile's mean of (variance of a sample) / (mean^2 + 0.01), the least total
// for an error E is n = sqrt(v) M / E samples, M the mean of sqrt(v) over the picture; M is that of the first
// adaptive_pilot blocks, later v are those of all blocks so far. A half that has come to its end while the other one
// goes on is still sampled, to let the other one decide; those samples are left out of the mean. Each half counts for
// one half of the mean, however long it is: weights that depended on the samples would bring a bias.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

namespace selvedge
{

inline constexpr int tile_side = 16;               // pixels
inline constexpr std::uint32_t adaptive_pilot = 4; // blocks of each half before the first decision
// Error that sampling aims for, over the one that was asked for: roots of four blocks' variances are low by about 1/12
// in pixels that stand alone, and M with them; the picture must not miss what was asked for.
inline constexpr double adaptive_aim = 0.85;

// Samples to choose the length of a block for (cloth_block_length) where `planned` of them (0: nobody knows) are taken
// at the most: decisions fall between pairs of blocks, and short ones waste the least.
inline std::uint32_t adaptive_planned(std::uint64_t planned)
{
    return static_cast<std::uint32_t>(std::min<std::uint64_t>(planned > 0 ? planned : 64, 64));
}

// Adaptive sampling of one tile.
struct TileState {
    std::uint64_t samples = 0;      // per pixel
    std::uint32_t kept[2] = {0, 0}; // blocks of each half that the mean consists of; 0: not decided
    bool done() const { return kept[0] > 0 && kept[1] > 0; }
};

// What the blocks so far say of one tile.
struct TileSpread {
    double variance[2] = {0.0, 0.0}; // v as each half sees it
    double count = 0.0;              // pixels times channels that it is the mean of
};

// Which tiles keep, of each half, the blocks that they have now.
struct TileStops {
    std::vector<bool> half[2];
};

// Decides after equally many blocks of both halves, adaptive_pilot at least. Marks the tiles' ends in `tiles`.
//   spreads  of each tile; of those that are done they do not matter
//   pilot    M as each half sees it; 0 at the first call, which sets it
//   samples  per pixel, so far
//   blocks   of each half, so far
TileStops judge_tiles(std::vector<TileState>& tiles, const std::vector<TileSpread>& spreads, double (&pilot)[2],
                      std::uint64_t samples, std::uint32_t blocks, double target_error);

bool all_done(const std::vector<TileState>& tiles);

} // namespace selvedge
