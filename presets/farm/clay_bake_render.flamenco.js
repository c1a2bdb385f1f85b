// SPDX-License-Identifier: GPL-3.0-or-later
//
// A job type for Flamenco 3: bakes the clay of a shot on one worker, renders it in chunks on all of
// them, and makes a film of the pictures. Put this file into the folder `scripts` beside
// flamenco-manager, and install and enable the extension in the Blender of every worker.
//
// It has been run against a stand-in of the API that Flamenco documents, and untested on a manager.
//
// A task that dies is simply run again: the bake goes on at its first missing frame, a chunk at its
// first missing picture. The bake goes over the frame range that the file itself sets, since clay
// has to be followed from its first frame on; `frames` are those to render.
//
// Written in ECMAScript 5.1 with `const`, which every engine understands.

const JOB_TYPE = {
    label: "Bake and Render Clay",
    description: "Bake the clay, render it in chunks of frames, make a film",
    settings: [
        { key: "frames", type: "string", required: true,
          eval: "f'{C.scene.frame_start}-{C.scene.frame_end}'",
          evalInfo: { showLinkButton: true, description: "Scene frame range" },
          description: "Frames to render, as '1-120' or '1-10, 50-60'" },
        { key: "chunk_size", type: "int32", default: 10, propargs: { min: 1 }, visible: "submission",
          description: "How many frames a worker renders at a time" },
        { key: "device", type: "string", default: "auto", choices: ["auto", "cpu", "cuda:0"],
          visible: "submission",
          description: "Where the clay is simulated. A bake can be resumed only on the kind of "
              + "device that it was begun on, so choose one where workers differ" },
        { key: "output_root", type: "string", subtype: "dir_path", required: true,
          visible: "submission",
          description: "Folder in which the job gets a folder of its own, for the bake and the "
              + "pictures" },
        { key: "output_path", type: "string", subtype: "dir_path", editable: false,
          eval: "str(Path(abspath(settings.output_root), jobname, '{timestamp}'))",
          description: "The job's folder" },

        // What the file says.
        { key: "blendfile", type: "string", required: true, visible: "web",
          description: "The .blend file with the clay" },
        { key: "fps", type: "float", visible: "hidden",
          eval: "C.scene.render.fps / C.scene.render.fps_base" },
        { key: "format", type: "string", required: true, visible: "web",
          eval: "C.scene.render.image_settings.file_format" },
        { key: "image_file_extension", type: "string", required: true, visible: "hidden",
          eval: "C.scene.render.file_extension" },
    ],
};

// Films cannot be rendered in chunks, and FFmpeg cannot read every kind of picture.
const FILM_FORMATS = ["FFMPEG", "AVI_JPEG", "AVI_RAW"];
const FORMATS_WITHOUT_FILM = ["OPEN_EXR", "OPEN_EXR_MULTILAYER"];

function compileJob(job) {
    const settings = job.settings;
    if (FILM_FORMATS.indexOf(settings.format) >= 0) {
        throw new Error("The scene's output format is a film (" + settings.format
            + "). Choose a format of pictures, such as PNG; this job makes a film of them.");
    }
    // The job then shows where its files really are.
    settings.output_path = settings.output_path.replace(
        "{timestamp}", formatTimestampLocal(job.created));
    const cache = path.join(settings.output_path, "clay_cache");
    const frames = path.join(settings.output_path, "frames");

    const bake = clayTask("bake", settings, [
        "bake", "--resume", "--cache", cache, "--device", settings.device,
    ]);
    job.addTask(bake);

    const chunks = frameChunker(settings.frames, settings.chunk_size);
    const renders = [];
    for (var i = 0; i < chunks.length; i++) {
        var render = clayTask("render-" + chunks[i], settings, [
            "render", "--resume", "--cache", cache,
            "--output", path.join(frames, "frame_####"), "--frames=" + chunks[i],
        ]);
        render.addDependency(bake);
        job.addTask(render);
        renders.push(render);
    }

    if (FORMATS_WITHOUT_FILM.indexOf(settings.format) >= 0) {
        print("No film: FFmpeg does not read " + settings.format);
        return;
    }
    const film = filmTask(settings, frames);
    for (var k = 0; k < renders.length; k++) {
        film.addDependency(renders[k]);
    }
    job.addTask(film);
}

// A task that runs `blender -b FILE.blend --command clay WORDS`.
function clayTask(name, settings, words) {
    const task = author.Task(name, "blender");
    task.addCommand(author.Command("blender-render", {
        exe: "{blender}",
        exeArgs: "{blenderArgs}",
        argsBefore: [],
        blendfile: settings.blendfile,
        args: ["--command", "clay"].concat(words),
    }));
    return task;
}

function filmTask(settings, frames) {
    const task = author.Task("film", "ffmpeg");
    task.addCommand(author.Command("frames-to-video", {
        exe: "ffmpeg",
        fps: settings.fps,
        inputGlob: path.join(frames, "frame_*" + settings.image_file_extension),
        outputFile: path.join(settings.output_path, path.stem(settings.blendfile) + ".mp4"),
        // H.264 in a form that all players know, which asks for even sides.
        args: [
            "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20",
            "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-y",
        ],
    }));
    return task;
}
