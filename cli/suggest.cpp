// SPDX-License-Identifier: Apache-2.0
#include "suggest.h"

#include <algorithm>

namespace lumivdb::cli {

int editDistance(const std::string& a, const std::string& b)
{
    const std::size_t width = b.size() + 1;
    std::vector<int> d((a.size() + 1) * width);
    const auto at = [&](std::size_t i, std::size_t j) -> int& { return d[i * width + j]; };
    for (std::size_t i = 0; i <= a.size(); ++i) at(i, 0) = static_cast<int>(i);
    for (std::size_t j = 0; j <= b.size(); ++j) at(0, j) = static_cast<int>(j);
    for (std::size_t i = 1; i <= a.size(); ++i) {
        for (std::size_t j = 1; j <= b.size(); ++j) {
            const int change = a[i - 1] == b[j - 1] ? 0 : 1;
            at(i, j) = std::min({at(i - 1, j) + 1, at(i, j - 1) + 1, at(i - 1, j - 1) + change});
            const bool swapped = i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1];
            if (swapped) at(i, j) = std::min(at(i, j), at(i - 2, j - 2) + 1);
        }
    }
    return at(a.size(), b.size());
}

std::string nearest(const std::string& word, const std::vector<std::string>& candidates)
{
    const auto letters = std::count_if(word.begin(), word.end(), [](char c) { return c != '-'; });
    std::string best;
    // More than half of the letters wrong is another word.
    int bestDistance = static_cast<int>(std::max<long>(1, (letters + 1) / 2)) + 1;
    for (const std::string& candidate : candidates) {
        if (letters >= 3 && candidate.compare(0, word.size(), word) == 0) return candidate;
        const int distance = editDistance(word, candidate);
        if (distance < bestDistance) {
            bestDistance = distance;
            best = candidate;
        }
    }
    return best;
}

std::string didYouMean(const std::string& word, const std::vector<std::string>& candidates)
{
    const std::string best = nearest(word, candidates);
    return best.empty() ? "" : ", did you mean " + best + "?";
}

} // namespace lumivdb::cli
