// SPDX-License-Identifier: Apache-2.0
#pragma once

// What lumivdb_bench_queries compares: OpenVDB's own sampler on one grid a coefficient, a dense
// array of the sampler's records, and the volumes that all are made of.

#include <lumivdb/core/sampler.h>

#include <memory>
#include <vector>

namespace query_bench {

using namespace lumivdb;

/// One Vec3S grid a coefficient (and three more for its derivatives), sampled one by one.
class NaiveGrids {
public:
    explicit NaiveGrids(const IrradianceVolume& volume, bool gradients);
    ~NaiveGrids();
    void irradiance(std::size_t count, const Vec3d* p, const Vec3f* n, Color* E) const;

private:
    struct Impl;
    std::unique_ptr<Impl> mImpl;
};

/// Records as the sampler's own, at (x·ny + y)·nz + z of an array: no topology, no validity, no
/// border. Batches of 16 with prefetch and the same sums.
class DenseArray {
public:
    DenseArray(const IrradianceVolume& uniform, bool gradients, Precision precision);
    ~DenseArray();
    void irradiance(std::size_t count, const Vec3d* p, const Vec3f* n, Color* E) const;
    struct Impl;

private:
    std::unique_ptr<Impl> mImpl;
};

/// 63³ cells of level 0.
IrradianceVolume uniformVolume(bool gradients);
/// 128³ lattice steps round a sphere: levels 0 to 4, cells that the sphere cuts with visibility,
/// some samples near it invalid.
IrradianceVolume adaptiveVolume(bool gradients);

/// Irradiance in double precision by the sampler's definition (Trilinear or Gradient), slow.
Vec3d referenceIrradiance(
    const IrradianceVolume& volume, bool gradients, const Vec3d& p, const Vec3f& n);

} // namespace query_bench
