// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file environment_projection.h
/// How an image covers the sphere: the geometry of Environment, without any light.
///
/// Every projection answers the same four questions about its texels, in the image's own frame
/// (before any rotation): which texel a direction falls in, where a point of a texel looks, how
/// densely such points lie on the sphere, and how to integrate over a texel. The precise layouts
/// are described at the top of environment_projection.cpp.

#include <lumivdb/bake/environment.h>

#include <memory>
#include <string>
#include <vector>

namespace lumivdb::detail {

struct Texel {
    int x, y; ///< column from the left, row from the top
};

/// A node of a quadrature rule: unit direction and the solid angle (sr) that it stands for.
struct SphereNode {
    Vec3d direction;
    double weight;
};

class ImageProjection {
public:
    ImageProjection(int imageWidth, int imageHeight)
        : width(imageWidth)
        , height(imageHeight)
    {
    }
    virtual ~ImageProjection() = default;

    /// The texel that unit direction @a d falls in; always one inside the image.
    virtual Texel texelAt(const Vec3d& d) const = 0;

    /// Direction of the point (s, t) ∈ [0,1]² of a texel, s to the right and t downwards.
    /// @return false where the point is not on the sphere (outside the disc or the cross).
    virtual bool pointIn(Texel texel, double s, double t, Vec3d& d) const = 0;

    /// Density per steradian at @a d of pointIn() of its texel with uniform s and t.
    virtual double pointDensity(Texel texel, const Vec3d& d) const = 0;

    /// Solid angle of a texel in steradians; 0 outside the disc or the cross.
    virtual double solidAngle(Texel texel) const = 0;

    /// Replaces @a nodes by a rule that integrates spherical harmonics of 6 bands over the texel
    /// to about 1e-8 of its solid angle.
    virtual void quadrature(Texel texel, std::vector<SphereNode>& nodes) const = 0;

    const int width, height;
};

/// The projection an image of this size has: @a asked itself, or by aspect for Auto.
/// @param what names the image in the message.
/// @throws Error(Input) when the size fits no projection, or not the one asked for.
EnvironmentProjection resolveProjection(
    EnvironmentProjection asked, int width, int height, const std::string& what);

/// @a projection must be what resolveProjection() returned for this size.
std::unique_ptr<const ImageProjection> makeProjection(
    EnvironmentProjection projection, int width, int height);

} // namespace lumivdb::detail
