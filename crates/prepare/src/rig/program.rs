//! The program `colmap`, step by step. Source: COLMAP's documentation, "Command-line Interface".

use std::fs::File;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use image::RgbImage;

use crate::PrepareError;

/// Polling interval of a running step.
const GLANCE: Duration = Duration::from_millis(100);

/// The program's messages where images do not suffice; it then ends with a failure.
const NO_MODEL: [&str; 3] = ["failed to create sparse model", "no good initial image pair", "no images with matches"];

/// A run of the program in its own folder, which the caller removes.
pub(super) struct Colmap<'a> {
    /// Holds `images/MOMENT/CAMERA.png`, the database and the program's output.
    folder: &'a Path,
    tell: &'a mut dyn FnMut(&str) -> ControlFlow<()>,
    /// Version 3.13 and later have other names for some groups of options.
    is_new: bool,
}

/// File name of one image.
pub(super) fn image_name(camera: usize, moment: usize) -> String {
    format!("{camera:04}/{moment:04}.png")
}

/// The camera of an image.
pub(super) fn camera_of(image: &str) -> Option<usize> {
    image.split('/').next()?.parse().ok()
}

/// Whether the program `colmap` can be run, which [`find_cameras`](crate::find_cameras) needs.
pub fn has_colmap() -> bool {
    let asked = command().arg("help").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
    asked.is_ok()
}

impl<'a> Colmap<'a> {
    /// Checks that the program is installed.
    ///
    /// # Errors
    /// [`PrepareError`] that says how to install it.
    pub fn find(folder: &'a Path, tell: &'a mut dyn FnMut(&str) -> ControlFlow<()>) -> Result<Self, PrepareError> {
        let asked = command().args(["feature_extractor", "-h"]).stdin(Stdio::null()).output();
        let said = asked.map_err(|error| PrepareError::Program {
            problem: format!("colmap cannot be run ({error}), expected it on the PATH (apt install colmap)"),
        })?;
        let said = [said.stdout, said.stderr].concat();
        let is_new = String::from_utf8_lossy(&said).contains("FeatureExtraction.use_gpu");
        Ok(Self { folder, tell, is_new })
    }

    /// Reports the next step.
    pub fn tell(&mut self, what: &str) -> Result<(), PrepareError> {
        match (self.tell)(what) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(PrepareError::Program { problem: "finding cameras was stopped".into() }),
        }
    }

    fn images(&self) -> PathBuf {
        self.folder.join("images")
    }

    fn database(&self) -> PathBuf {
        self.folder.join("database.db")
    }

    /// Stores the images of a moment, one a camera.
    pub fn store(&self, images: &[RgbImage], moment: usize) -> Result<(), PrepareError> {
        for (camera, image) in images.iter().enumerate() {
            let path = self.images().join(image_name(camera, moment));
            let parent = path.parent().unwrap_or(self.folder);
            std::fs::create_dir_all(parent).map_err(|error| PrepareError::Io { path: parent.into(), error })?;
            image.save(&path).map_err(|error| PrepareError::invalid(&path, format!("cannot be written: {error}")))?;
        }
        Ok(())
    }

    /// Finds features in all images that have none yet. The images of one camera share its intrinsics.
    pub fn find_features(&mut self, num_images: usize) -> Result<(), PrepareError> {
        let mut command = command();
        command.arg("feature_extractor").arg("--database_path").arg(self.database());
        command.arg("--image_path").arg(self.images());
        command.args(["--ImageReader.single_camera_per_folder", "1", "--ImageReader.camera_model", "SIMPLE_RADIAL"]);
        command.args([self.option("Extraction.use_gpu"), "0".into()]);
        self.run(command, "features", &|said| {
            let done = said.matches("Processed file [").count();
            format!("finding features, image {done} of {num_images}")
        })
    }

    /// Matches pairs of images.
    ///
    /// - `pairs`: a line for each, two names
    pub fn match_images(&mut self, pairs: &[(String, String)]) -> Result<(), PrepareError> {
        let list = self.folder.join("pairs.txt");
        let lines: String = pairs.iter().map(|(a, b)| format!("{a} {b}\n")).collect();
        std::fs::write(&list, lines).map_err(|error| PrepareError::Io { path: list.clone(), error })?;
        let mut command = command();
        command.arg("matches_importer").arg("--database_path").arg(self.database());
        command.arg("--match_list_path").arg(list).args(["--match_type", "pairs"]);
        command.args([self.option("Matching.use_gpu"), "0".into()]);
        let num_pairs = pairs.len();
        self.run(command, "matches", &|_| format!("matching {num_pairs} pairs of images"))
    }

    /// Places cameras and points.
    ///
    /// - returns: the folders of the models that were found, in COLMAP's text format
    pub fn place(&mut self, num_images: usize) -> Result<Vec<PathBuf>, PrepareError> {
        let sparse = self.folder.join("sparse");
        let failed = |error| PrepareError::Io { path: sparse.clone(), error };
        let _ = std::fs::remove_dir_all(&sparse);
        std::fs::create_dir_all(&sparse).map_err(failed)?;
        let mut command = command();
        command.arg("mapper").arg("--database_path").arg(self.database()).arg("--image_path").arg(self.images());
        command.arg("--output_path").arg(&sparse);
        // Rigs are small, and some of their cameras stand close together.
        command.args(["--Mapper.min_model_size", "3", "--Mapper.init_min_tri_angle", "4"]);
        // A rig without a first pair is a result, not a failure: there is no model then.
        let result = self.run(command, "mapper", &|said| {
            let done = said.matches("Registering image #").count();
            format!("placing cameras, image {done} of {num_images}")
        });
        let mut models: Vec<PathBuf> = Vec::new();
        for entry in std::fs::read_dir(&sparse).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if path.join("cameras.bin").is_file() {
                models.push(path);
            }
        }
        if models.is_empty() {
            let said = self.said("mapper").to_lowercase();
            let is_result = NO_MODEL.iter().any(|words| said.contains(words));
            return result.map(|()| models).or_else(|error| if is_result { Ok(Vec::new()) } else { Err(error) });
        }
        models.sort();
        for model in &models {
            let mut command = self::command();
            command.arg("model_converter").arg("--input_path").arg(model).arg("--output_path").arg(model);
            command.args(["--output_type", "TXT"]);
            self.run(command, "text", &|_| "writing the cameras".into())?;
        }
        Ok(models)
    }

    fn option(&self, name: &str) -> String {
        let group = if self.is_new { "Feature" } else { "Sift" };
        format!("--{group}{name}")
    }

    fn said(&self, step: &str) -> String {
        let said = std::fs::read(self.folder.join(format!("{step}.log"))).unwrap_or_default();
        String::from_utf8_lossy(&said).into_owned()
    }

    /// Runs a step to its end, or until the caller stops it.
    ///
    /// - `progress`: from the program's output to the words of progress
    fn run(&mut self, mut command: Command, step: &str, progress: &dyn Fn(&str) -> String) -> Result<(), PrepareError> {
        let path = self.folder.join(format!("{step}.log"));
        let failed = |error| PrepareError::Io { path: path.clone(), error };
        let log = File::create(&path).map_err(failed)?;
        let also = log.try_clone().map_err(failed)?;
        let mut child = command
            .stdin(Stdio::null())
            .stdout(log)
            .stderr(also)
            .spawn()
            .map_err(|error| PrepareError::Program { problem: format!("colmap cannot be run: {error}") })?;
        loop {
            if let Some(status) = child.try_wait().map_err(failed)? {
                if status.success() {
                    return Ok(());
                }
                let said = self.said(step);
                let last = said.lines().map(str::trim).rfind(|line| !line.is_empty()).unwrap_or("nothing");
                return Err(PrepareError::Program { problem: format!("colmap failed ({status}): {last}") });
            }
            if let Err(stopped) = self.tell(&progress(&self.said(step))) {
                let _ = child.kill();
                let _ = child.wait();
                return Err(stopped);
            }
            std::thread::sleep(GLANCE);
        }
    }
}

fn command() -> Command {
    let mut command = Command::new("colmap");
    // Some builds need a screen even where they draw nothing.
    command.env("QT_QPA_PLATFORM", "offscreen");
    command
}
