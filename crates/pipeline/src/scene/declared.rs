//! Declarations in the files of a scene beside its Gaussians: names, cameras, frames, light, errors, foreground,
//! identities. Also the size of the files.

use std::collections::BTreeSet;
use std::path::Path;
use std::{fs, io};

use tcgs_codec::{FOREGROUND, FileCamera, Loss, UpAxis, read_labels, read_views};
use tcgs_interchange::{ReadLimits, read_params_foreground};

use super::{Content, OpenScene};
use crate::PipelineError;

impl OpenScene {
    /// Name of the capture, as a `.tcgs` file says it; none for anything else.
    pub fn name(&self) -> Option<&str> {
        match &self.content {
            Content::File(file) => Some(&file.info.name),
            Content::Symbols(compact) => Some(&compact.info.name),
            _ => None,
        }
    }

    /// Cameras of the capture that a `.tcgs` file gives players to start from; empty for anything else.
    ///
    /// # Errors
    /// [`PipelineError::Decode`] if the file cannot be read.
    pub fn cameras(&self) -> Result<Vec<FileCamera>, PipelineError> {
        let Content::File(file) = &self.content else { return Ok(Vec::new()) };
        let data = file.file().application_data();
        data.map(|data| read_views(&data)).map_err(|error| PipelineError::Decode { path: self.path.clone(), error })
    }

    /// The axis that points up, as a `.tcgs` file says it; unknown for anything else.
    pub fn up(&self) -> UpAxis {
        match &self.content {
            Content::File(file) => file.info.up,
            Content::Symbols(compact) => compact.info.up,
            _ => UpAxis::Unknown,
        }
    }

    /// Gains of red, green and blue at a timestep, by which a renderer multiplies colours
    /// ([`Light`](tcgs_codec::Light)); 1 unless the scene is a `.tcgs` file.
    pub fn light(&self, timestep: usize) -> [f32; 3] {
        match &self.content {
            Content::File(file) => file.light.at(timestep),
            Content::Symbols(compact) => compact.light.at(timestep),
            _ => [1.0; 3],
        }
    }

    /// Losses of a `.tcgs` file that was cut; none for anything else.
    pub fn loss(&self) -> Option<&Loss> {
        match &self.content {
            Content::File(file) => file.loss.as_ref(),
            _ => None,
        }
    }

    /// Names of attributes with their largest errors against the compressed source, as a `.tcgs` file declares them
    /// ([`tcgs_codec::attribute_error`]); empty for anything else.
    pub fn declared_errors(&self) -> Vec<(String, f32)> {
        match &self.content {
            Content::File(file) => file.file().archive().declared_errors().to_vec(),
            Content::Symbols(compact) => compact.declared_errors.clone(),
            _ => Vec::new(),
        }
    }

    /// [`Self::first_frame`], if the files say it.
    pub fn declared_first_frame(&self) -> Option<usize> {
        let is_declared = match &self.content {
            Content::Params(params) => params.has_origin,
            Content::TimestepFiles(files) => files.first_frame().is_some(),
            Content::Fourdgs(_) | Content::Floats { .. } => false,
            Content::File(_) | Content::Symbols(_) | Content::Run(_) | Content::Chapters(_) => true,
        };
        is_declared.then_some(self.first_frame)
    }

    /// [`Self::frame_rate`], if the files say it.
    pub fn declared_frame_rate(&self) -> Option<f64> {
        let is_declared = match &self.content {
            Content::Params(params) => params.has_origin,
            Content::TimestepFiles(_) => false,
            _ => self.frame_rate > 0.0,
        };
        is_declared.then_some(self.frame_rate)
    }

    /// Bytes of the scene's files: the checkpoints of a run, or all files of a sequence, without the buffers of `.gltf`
    /// files. 0 if the scene is in memory.
    ///
    /// # Errors
    /// The operating system's error about a file or folder.
    pub fn file_bytes(&self) -> io::Result<u64> {
        let length = |path: &Path| Ok::<_, io::Error>(fs::metadata(path)?.len());
        match &self.content {
            Content::File(_) | Content::Params(_) | Content::Fourdgs(_) => length(&self.path),
            Content::Symbols(_) | Content::Floats { .. } => Ok(0),
            Content::TimestepFiles(files) => files.files().iter().map(|path| length(path)).sum(),
            Content::Run(run) => (0..run.num_timesteps).map(|t| length(&run.run.checkpoint_path(t))).sum(),
            Content::Chapters(chapters) => chapters.scenes().iter().map(Self::file_bytes).sum(),
        }
    }

    /// Indices, among all Gaussians, of those that live at a timestep, ascending: the order of [`Self::at`]. None if
    /// all live, or if the scene does not say which Gaussian of one timestep is which of another.
    ///
    /// # Errors
    /// [`PipelineError::Decode`] if the file is damaged.
    pub(crate) fn living(&self, timestep: usize) -> Result<Option<Vec<usize>>, PipelineError> {
        match &self.content {
            Content::File(file) => {
                let living = file.file().living(timestep);
                living.map(Some).map_err(|error| PipelineError::Decode { path: self.path.clone(), error })
            }
            _ => Ok(self.lives().map(|lives| lives.living(timestep))),
        }
    }

    /// Which of the Gaussians that live at a timestep belong to the foreground; none if the scene does not say.
    ///
    /// # Errors
    /// [`PipelineError`] if a file is damaged.
    pub(crate) fn foreground(&self, timestep: usize) -> Result<Option<Vec<bool>>, PipelineError> {
        Ok(match &self.content {
            Content::Run(run) if run.lives.is_some() => Some(run.parameters(timestep)?.foreground),
            Content::Params(params) => self.foreground_of_params(params.num_gaussians, params.limits)?,
            Content::File(file) => {
                let decode_error = |error| PipelineError::Decode { path: self.path.clone(), error };
                let data = file.file().application_data().map_err(decode_error)?;
                let of_all =
                    read_labels(&data).and_then(|labels| labels.members(FOREGROUND, file.info.num_gaussians as usize));
                let living = self.living(timestep)?;
                of_all.zip(living).map(|(of_all, living)| living.into_iter().map(|g| of_all[g]).collect())
            }
            _ => self.first_checkpoint().map(|first| first.parameters.foreground.clone()),
        })
    }

    fn foreground_of_params(
        &self,
        num_gaussians: usize,
        limits: ReadLimits,
    ) -> Result<Option<Vec<bool>>, PipelineError> {
        let foreground = read_params_foreground(&self.path, limits)?;
        match &foreground {
            Some(marks) if marks.len() != num_gaussians => {
                let (found, expected) = (format!("seg_colors of {} Gaussians", marks.len()), num_gaussians.to_string());
                Err(PipelineError::input(self.path.display(), found, expected))
            }
            _ => Ok(foreground),
        }
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
