//! Declarations in the files of a scene beside its Gaussians: names, cameras, frames, light, errors, foreground,
//! identities. Also the size of the files.

use std::collections::BTreeSet;
use std::{fs, io};

use tcgs_codec::{FileCamera, Loss, UpAxis};
use tcgs_core::Trust;
use tcgs_interchange::{Axes, ReadNote};

use crate::{OpenScene, PipelineError};

impl OpenScene {
    /// Name of the capture, as a `.tcgs` file says it; none for anything else.
    pub fn name(&self) -> Option<&str> {
        self.content.info().map(|info| info.name.as_str())
    }

    /// Cameras of the capture that a `.tcgs` file gives players to start from; empty for anything else.
    ///
    /// # Errors
    /// [`PipelineError::Decode`] if the file cannot be read.
    pub fn cameras(&self) -> Result<Vec<FileCamera>, PipelineError> {
        self.content.cameras()
    }

    /// From where pictures can be trusted, as a `.tcgs` file says it; none for anything else.
    ///
    /// # Errors
    /// [`PipelineError::Decode`] if the file cannot be read.
    pub fn trust(&self) -> Result<Option<Trust>, PipelineError> {
        self.content.trust()
    }

    /// The axis that points up, as a `.tcgs` file says it; unknown for anything else.
    pub fn up(&self) -> UpAxis {
        self.content.info().map_or(UpAxis::Unknown, |info| info.up)
    }

    /// Gains of red, green and blue at a timestep, by which a renderer multiplies colours
    /// ([`Light`](tcgs_codec::Light)); 1 unless the scene is a `.tcgs` file.
    pub fn light(&self, timestep: usize) -> [f32; 3] {
        self.content.light(timestep)
    }

    /// Losses of a `.tcgs` file that was cut; none for anything else.
    pub fn loss(&self) -> Option<&Loss> {
        self.content.loss()
    }

    /// Names of attributes with their largest errors against the compressed source, as a `.tcgs` file declares them
    /// ([`tcgs_codec::attribute_error`]); empty for anything else.
    pub fn declared_errors(&self) -> Vec<(String, f32)> {
        self.content.declared_errors()
    }

    /// Assumptions of readers when the scene was opened, and replacements at the timesteps read so far. Empty unless
    /// the scene's files are another program's.
    ///
    /// ```
    /// use tcgs_core::Gaussians;
    /// use tcgs_interchange::write_ply_to;
    /// use tcgs_pipeline::{OpenScene, OpenSettings};
    ///
    /// let folder = tempfile::tempdir()?;
    /// let path = folder.path().join("a.ply");
    /// let mut gaussians = Gaussians::zeros(5);
    /// gaussians.logit_opacities_mut()[0] = f32::INFINITY;
    /// write_ply_to(std::fs::File::create(&path)?, &gaussians)?;
    ///
    /// let scene = OpenScene::open(&path, OpenSettings::default())?;
    /// assert!(scene.notes().is_empty() && scene.at(0)?.logit_opacities()[0].is_finite());
    /// assert!(scene.notes()[0].to_string().contains("opacities 1, scales 0"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn notes(&self) -> Vec<ReadNote> {
        self.content.notes()
    }

    /// Axes of the Gaussians in other programs' files; none for anything else. Scenes are in the axes of PLY files.
    pub fn axes(&self) -> Option<Axes> {
        self.content.axes()
    }

    /// [`Self::first_frame`], if the files say it.
    pub fn declared_first_frame(&self) -> Option<usize> {
        self.content.declares_first_frame().then_some(self.first_frame)
    }

    /// [`Self::frame_rate`], if the files say it.
    pub fn declared_frame_rate(&self) -> Option<f64> {
        self.content.declares_frame_rate(self.frame_rate).then_some(self.frame_rate)
    }

    /// Bytes of the scene's files: the checkpoints of a run, or all files of a sequence, without the buffers of `.gltf`
    /// files. 0 if the scene is in memory.
    ///
    /// # Errors
    /// The operating system's error about a file or folder.
    pub fn file_bytes(&self) -> io::Result<u64> {
        self.content.files(&self.path).iter().map(|path| Ok(fs::metadata(path)?.len())).sum()
    }

    /// Indices, among all Gaussians, of those that live at a timestep, ascending: the order of [`Self::at`]. None if
    /// all live, or if the scene does not say which Gaussian of one timestep is which of another.
    ///
    /// # Errors
    /// [`PipelineError::Decode`] if the file is damaged.
    pub(crate) fn living(&self, timestep: usize) -> Result<Option<Vec<usize>>, PipelineError> {
        self.content.living(timestep)
    }

    /// Which of the Gaussians that live at a timestep belong to the foreground; none if the scene does not say.
    ///
    /// # Errors
    /// [`PipelineError`] if a file is damaged.
    pub(crate) fn foreground(&self, timestep: usize) -> Result<Option<Vec<bool>>, PipelineError> {
        self.content.foreground(timestep)
    }

    /// Which Gaussians of a scene of floats belong to the foreground; none if the scene does not say, or if all do.
    ///
    /// # Errors
    /// [`PipelineError`] if a file is damaged.
    pub(crate) fn foreground_of_all(&self) -> Result<Option<Vec<bool>>, PipelineError> {
        let foreground = match self.lives() {
            None => self.foreground(0)?,
            Some(lives) => {
                let mut of_all = vec![true; lives.len()];
                let births: BTreeSet<usize> = lives.iter().map(|life| life.birth as usize).collect();
                for timestep in births.into_iter().take_while(|&timestep| timestep < self.num_timesteps()) {
                    let Some(now) = self.foreground(timestep)? else { return Ok(None) };
                    lives
                        .living(timestep)
                        .into_iter()
                        .zip(now)
                        .for_each(|(id, is_foreground)| of_all[id] = is_foreground);
                }
                Some(of_all)
            }
        };
        Ok(foreground.filter(|marks| marks.contains(&false)))
    }
}
