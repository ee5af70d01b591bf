// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file volume_command.h
/// A command that makes a volume from a scene: bake and lpv.

#include "scene_options.h"
#include "volume_output.h"

namespace lumivdb::cli {

class VolumeCommand : public Command {
public:
    /// Checks everything first, then reads the scene, makes the volume and writes it.
    void run(const Arguments& arguments) final;

protected:
    struct Seconds {
        double load = 0, build = 0, make = 0, write = 0;
    };
    /// What make() leaves for run() to write and to say.
    struct Made {
        IrradianceVolume& volume;
        const std::vector<std::string>& warnings;
        const std::vector<std::string>& decisions;
        double spacing;
    };

    void declareScene(Arguments& arguments);
    /// --visibility and --up, last in the section "Volume".
    void declareVolume(Arguments& arguments, bool& visibility);
    void declareOutput(Arguments& arguments, const std::string& report);

    /// Checks the options. @throws Error(Usage).
    virtual void prepare(const Arguments& arguments) = 0;
    virtual Made make(const Tracer& tracer, Progress& progress) = 0;
    /// Whether the command line leaves the spacing to the scene's size; then metadata name it.
    virtual bool spacingFromScene(const Arguments& arguments) const = 0;
    virtual void summarise(const Seconds& seconds) const = 0;
    virtual Json report(const Scene& scene, const Seconds& seconds) const = 0;
    /// The file is in its place.
    virtual void written() { }
    /// Sentence to add to an error that ended the work, "" or with a blank before it.
    virtual std::string afterError(ErrorCode /*code*/) const { return ""; }
    /// Last of all. @throws Error where the volume is not what was asked for.
    virtual void judge() const { }

    void noteLevels(const std::vector<std::uint64_t>& cellsByLevel) const;
    void noteFile(double seconds, const std::string& stages) const;
    /// Members that both reports end with.
    void addFile(Json& json, const IrradianceVolume& volume) const;

    CommonOptions mCommon;
    SceneOptions mScene;
    VolumeOutput mOutput;

private:
    Made makeAndWrite(
        const Arguments& arguments, const Tracer& tracer, ProgressBar& progress, Seconds& seconds);
    std::string mUpAxis = "y";
};

} // namespace lumivdb::cli
