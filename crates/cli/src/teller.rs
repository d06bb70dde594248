//! Reports events of a long call: progress, a line per timestep, warnings. Stops the call after Ctrl-C.

use std::ops::ControlFlow;

use tcgs_pipeline::{ErrorTrial, Event, Observer, TimestepSummary, Trial, TuningTrial};

use crate::attribute_errors::{show, word};
use crate::interrupt;
use crate::output::show_bytes;
use crate::progress::Progress;
use crate::terminal::{note, say};

/// The observer of every long call of the command line.
#[derive(Default)]
pub struct Teller {
    progress: Option<Progress>,
    /// Whether the header of the table of timesteps has been printed.
    has_head: bool,
    /// Gaussians at the start of the timestep.
    num_before: Option<usize>,
    /// Whether the reason for a falling number of Gaussians has been printed: for the first timestep, for later ones.
    said_fewer: [bool; 2],
    /// The error of writing to standard output.
    failed: Option<anyhow::Error>,
}

impl Teller {
    /// Makes a call with this observer. A failure of standard output takes precedence over the call's result.
    pub fn watch<T, E: Into<anyhow::Error>>(
        mut self,
        call: impl FnOnce(&mut Self) -> Result<T, E>,
    ) -> anyhow::Result<T> {
        let result = call(&mut self);
        match self.failed {
            Some(error) => Err(error),
            None => result.map_err(Into::into),
        }
    }

    /// Whether the call continues, after printing.
    fn go_on(&mut self, told: anyhow::Result<()>) -> ControlFlow<()> {
        match told {
            Ok(()) => interrupt::asked(),
            Err(error) => {
                self.failed = Some(error);
                ControlFlow::Break(())
            }
        }
    }

    /// Prints lines about the result of a step, whose progress has ended.
    pub fn lines(&mut self, lines: &[String]) -> ControlFlow<()> {
        self.progress = None;
        let told = lines.iter().try_for_each(|line| say(line));
        self.go_on(told)
    }

    fn step(&mut self, detail: impl FnOnce() -> String) {
        if let Some(progress) = &mut self.progress {
            progress.step(detail);
        }
    }

    fn advance_to(&mut self, num_done: usize, detail: impl FnOnce() -> String) {
        if let Some(progress) = &mut self.progress {
            progress.advance_to(num_done, detail);
        }
    }

    fn timestep(&mut self, summary: &TimestepSummary) -> anyhow::Result<()> {
        let Some(progress) = &self.progress else { return Ok(()) };
        let name = if summary.held_out { "test PSNR" } else { "train PSNR" };
        if !self.has_head {
            progress.say(&format!("timestep   frame  Gaussians  {name}  seconds"))?;
            self.has_head = true;
        }
        let TimestepSummary { timestep, frame, num_gaussians, psnr, seconds, .. } = summary;
        let width = name.len();
        progress.say(&format!("{timestep:>8}  {frame:>6}  {num_gaussians:>9}  {psnr:>width$.2}  {seconds:>7.1}"))?;
        let said = &mut self.said_fewer[usize::from(*timestep > 0)];
        if let Some(before) = self.num_before.replace(*num_gaussians).filter(|before| num_gaussians < before && !*said)
        {
            *said = true;
            progress.say(&format!("Gaussians become fewer ({num_gaussians} of {before}): {}", fewer(*timestep)))?;
        }
        Ok(())
    }
}

impl Observer for Teller {
    fn hear(&mut self, event: &Event) -> ControlFlow<()> {
        match event {
            Event::Begun { work, num_steps } => self.progress = Some(Progress::new(work.name(), *num_steps)),
            Event::FewPoints { found, expected } => note(&format!(
                "warning: {found} points to start from, expected {expected} or more: what lies far from all of them \
                 stays empty; `tcgs prepare` makes points from the images, `--points FILE` takes others"
            )),
            Event::SetAside { checkpoint, problem } => {
                note(&format!("{}: {problem}; set aside, its timestep is trained again", checkpoint.display()));
            }
            Event::Iteration { progress: p, num_done } => {
                self.num_before.get_or_insert(p.num_gaussians);
                self.advance_to(*num_done, || {
                    format!("timestep {}, {} Gaussians, loss {:.4}", p.timestep, p.num_gaussians, p.loss)
                });
            }
            Event::Timestep { summary: s, num_done } => {
                self.advance_to(*num_done, || format!("timestep {}, {} Gaussians", s.timestep, s.num_gaussians));
                let told = self.timestep(s);
                return self.go_on(told);
            }
            Event::Tried(trial) => return self.go_on(say(&line(trial))),
            Event::Tuned(trial) => return self.go_on(say(&tuning_line(trial))),
            Event::Measured(trial) => return self.go_on(say(&error_line(trial))),
            Event::Frame(frame) => self.step(|| format!("frame {frame}")),
            Event::Step { num_done, what } => self.advance_to(*num_done, || (*what).into()),
            _ => {}
        }
        interrupt::asked()
    }
}

/// The reason why a timestep ends with fewer Gaussians than it began with.
fn fewer(timestep: usize) -> &'static str {
    match timestep {
        0 => "the first timestep removes those that are nearly transparent, too large, or hardly needed by the images",
        _ => "those are removed that no training camera sees any more",
    }
}

/// A table row for a trial of the target search.
pub fn line(trial: &Trial) -> String {
    format!("{:>7.2}  {:>11}  {:>8}", trial.quality(), show_bytes(trial.bytes), show_psnr(trial.psnr))
}

/// A table row for a trial of tuning.
fn tuning_line(trial: &TuningTrial) -> String {
    let saved = trial.saved.map_or("-".into(), |saved| format!("{:.1} %", 100.0 * saved));
    let psnr = format!("{:.3} dB", trial.psnr);
    format!("{:<22}  {:>11}  {psnr:>9}  {saved:>7}", trial.setting, show_bytes(trial.bytes))
}

/// A table row for a trial of the search for small errors.
fn error_line(trial: &ErrorTrial) -> String {
    let errors = trial.errors.iter().map(|(name, error)| format!("{} {}", word(name), show(*error)));
    format!("{:>11}  {}", show_bytes(trial.bytes), errors.collect::<Vec<_>>().join("  "))
}

pub fn show_psnr(psnr: Option<f64>) -> String {
    psnr.map_or("-".into(), |psnr| format!("{psnr:.2} dB"))
}
