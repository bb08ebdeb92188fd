// The rule by which tiles stop.
#include "reference/adaptive.hpp"

#include <cmath>
#include <limits>

namespace selvedge
{

TileStops judge_tiles(std::vector<TileState>& tiles, const std::vector<TileSpread>& spreads, double (&pilot)[2],
                      std::uint64_t samples, std::uint32_t blocks, double target_error)
{
    if (pilot[0] == 0.0) { // nothing has stopped yet
        double all = 0.0;
        for (const TileSpread& spread : spreads) {
            for (int half = 0; half < 2; ++half) pilot[half] += spread.count * std::sqrt(spread.variance[half]);
            all += spread.count;
        }
        for (double& mean : pilot) mean = std::max(mean / all, std::numeric_limits<double>::min());
    }
    TileStops stops;
    for (std::vector<bool>& half : stops.half) half.resize(tiles.size());
    for (std::size_t k = 0; k < tiles.size(); ++k) {
        TileState& tile = tiles[k];
        if (tile.done()) continue;
        for (int half = 0; half < 2; ++half) {
            const bool enough =
                double(samples) * adaptive_aim * target_error >= pilot[half] * std::sqrt(spreads[k].variance[half]);
            if (enough && tile.kept[1 - half] == 0) stops.half[1 - half][k] = true;
        }
        for (int half = 0; half < 2; ++half)
            if (stops.half[half][k]) tile.kept[half] = blocks;
    }
    return stops;
}

bool all_done(const std::vector<TileState>& tiles)
{
    return std::all_of(tiles.begin(), tiles.end(), [](const TileState& tile) { return tile.done(); });
}

} // namespace selvedge
