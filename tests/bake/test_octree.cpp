// SPDX-License-Identifier: Apache-2.0
// The octree of a bake: what exists, balance, merging; against brute force.

#include "../../bake/src/octree.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <set>

using namespace lumivdb;

namespace {

Octree randomTree(const LatticeBox& box, int levels, std::uint64_t seed, double chance)
{
    Octree tree(box, levels);
    CounterRng rng(seed);
    std::vector<CellKey> cells = tree.roots();
    while (!cells.empty()) {
        const CellKey cell = cells.back();
        cells.pop_back();
        if (cell.level == 0 || !(rng.next() < chance)) continue;
        tree.split(cell);
        for (const CellKey& child : tree.children(cell)) cells.push_back(child);
    }
    return tree;
}

bool touch(const CellKey& a, const CellKey& b)
{
    for (int i = 0; i < 3; ++i) {
        if (a.origin[i] > b.origin[i] + b.size() || b.origin[i] > a.origin[i] + a.size())
            return false;
    }
    return true;
}

bool isBalanced(const Octree& tree)
{
    const std::vector<CellKey> leaves = tree.leaves();
    for (const CellKey& a : leaves)
        for (const CellKey& b : leaves) {
            if (a.level > b.level + 1 && touch(a, b)) return false;
        }
    return true;
}

} // namespace

TEST_CASE("leaves cover the box once, also where it is not aligned", "[octree]")
{
    const LatticeBox box{{-5, 3, 0}, {20, 9, 17}};
    const Octree tree = randomTree(box, 3, 7, 0.6);
    double inside = 0;
    for (const CellKey& leaf : tree.leaves()) {
        CHECK(tree.meetsBox(leaf));
        CHECK(tree.exists(leaf));
        double part = 1;
        for (int a = 0; a < 3; ++a) {
            CHECK(leaf.origin[a] % leaf.size() == 0);
            part *= std::min(leaf.origin[a] + leaf.size(), box.upper[a])
                - std::max(leaf.origin[a], box.lower[a]);
        }
        inside += part;
    }
    CHECK(inside == 25.0 * 6 * 17);
}

TEST_CASE(
    "balance: no leaf touches one of more than twice its size, nothing else is split", "[octree]")
{
    const LatticeBox box{{-16, 0, 0}, {32, 32, 32}};
    int unbalanced = 0;
    for (std::uint64_t seed = 1; seed <= 12; ++seed) {
        Octree tree = randomTree(box, 4, seed, 0.45);
        unbalanced += isBalanced(tree) ? 0 : 1;
        const std::vector<CellKey> before = tree.splitCells();
        tree.balance();
        CHECK(isBalanced(tree));
        for (const CellKey& cell : before) CHECK(tree.isSplit(cell));
        // Every split that was added is needed: without it the tree is unbalanced.
        const std::set<CellKey> old(before.begin(), before.end());
        for (const CellKey& cell : tree.splitCells()) {
            if (old.count(cell) || !tree.mayMerge(cell)) continue;
            bool leavesOnly = true;
            for (int i = 0; i < 8; ++i) leavesOnly = leavesOnly && !tree.isSplit(cell.child(i));
            CHECK_FALSE(leavesOnly);
        }
    }
    CHECK(unbalanced > 6); // else the test shows nothing
}

TEST_CASE("merging what may be merged keeps balance; what may not would break it", "[octree]")
{
    const LatticeBox box{{0, 0, 0}, {32, 32, 16}};
    int refused = 0;
    for (std::uint64_t seed = 20; seed < 28; ++seed) {
        Octree tree = randomTree(box, 4, seed, 0.5);
        tree.balance();
        for (int level = 1; level <= 4; ++level) {
            for (const CellKey& cell : tree.mergeable(level)) {
                const bool may = tree.mayMerge(cell);
                tree.merge(cell);
                CHECK(isBalanced(tree) == may);
                refused += may ? 0 : 1;
                tree.split(cell);
            }
        }
    }
    CHECK(refused > 0);
}
