//! The clock of a player: which timestep is due.

/// Frames per second of a scene that does not say.
const DEFAULT_FRAME_RATE: f64 = 30.0;

/// A position in a scene's time that advances at a set speed, with or without a loop.
///
/// Positions are in timesteps: timestep `t` is due from position `t` up to, not including, `t + 1`. Real time advances
/// the position by the frame rate, or by the times of the timesteps if these are not evenly spaced.
///
/// ```
/// let mut clock = tcgs_play::Clock::new(24, 30.0);
/// clock.play();
/// clock.advance(1000.0);
/// clock.advance(1100.0);
/// assert_eq!(clock.timestep(), 3, "a tenth of a second at 30 timesteps a second");
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Clock {
    num_timesteps: usize,
    frame_rate: f64,
    /// `[num_timesteps]` seconds from the first timestep, if the timesteps are not evenly spaced.
    times: Option<Vec<f64>>,
    position: f64,
    is_playing: bool,
    is_looping: bool,
    speed: f64,
    last_ms: Option<f64>,
}

impl Clock {
    /// A clock that stands at the first timestep, set to loop at the scene's own speed.
    ///
    /// - `num_timesteps`: at least 1
    /// - `frame_rate`: timesteps a second; 0 if unknown, which counts as 30
    pub fn new(num_timesteps: usize, frame_rate: f64) -> Self {
        let frame_rate = if frame_rate > 0.0 { frame_rate } else { DEFAULT_FRAME_RATE };
        Self {
            num_timesteps,
            frame_rate,
            times: None,
            position: 0.0,
            is_playing: false,
            is_looping: true,
            speed: 1.0,
            last_ms: None,
        }
    }

    /// The same clock for timesteps that are not evenly spaced. The frame rate gives the duration of the last one.
    ///
    /// - `times`: `[num_timesteps]` seconds, strictly ascending from 0
    ///
    /// # Panics
    /// If there is another number of times than of timesteps.
    #[must_use]
    pub fn with_times(self, times: Vec<f64>) -> Self {
        assert_eq!(times.len(), self.num_timesteps, "times against timesteps");
        Self { times: Some(times), ..self }
    }

    /// The position in seconds from the first timestep, at speed 1.
    pub fn seconds(&self) -> f64 {
        let Some(times) = &self.times else { return self.position / self.frame_rate };
        let timestep = self.timestep();
        times[timestep] + (self.position - timestep as f64) * self.duration(times, timestep)
    }

    /// Seconds from the first timestep to the end of the last one, at speed 1.
    fn length(&self) -> f64 {
        let frame = 1.0 / self.frame_rate;
        self.times
            .as_ref()
            .and_then(|times| times.last())
            .map_or(self.num_timesteps as f64 * frame, |last| last + frame)
    }

    /// How long a timestep is due, seconds.
    fn duration(&self, times: &[f64], timestep: usize) -> f64 {
        times.get(timestep + 1).map_or(1.0 / self.frame_rate, |next| next - times[timestep])
    }

    /// Position of a time.
    ///
    /// - `seconds`: from 0 up to [`Self::length`]
    fn position_at(&self, seconds: f64) -> f64 {
        let Some(times) = &self.times else { return seconds * self.frame_rate };
        let timestep = times.partition_point(|&time| time <= seconds).max(1) - 1;
        timestep as f64 + (seconds - times[timestep]) / self.duration(times, timestep)
    }

    /// The timestep that is due.
    pub fn timestep(&self) -> usize {
        (self.position as usize).min(self.num_timesteps - 1)
    }

    /// The position in timesteps, from 0 up to, not including, their number.
    pub fn position(&self) -> f64 {
        self.position
    }

    /// Timesteps a second at speed 1.
    pub fn frame_rate(&self) -> f64 {
        self.frame_rate
    }

    /// Whether time passes.
    pub fn is_playing(&self) -> bool {
        self.is_playing
    }

    /// Whether the speed is negative.
    pub fn is_backwards(&self) -> bool {
        self.speed < 0.0
    }

    /// Whether the first timestep follows the last one, and backwards the last one the first.
    pub fn is_looping(&self) -> bool {
        self.is_looping
    }

    /// Lets time pass. A clock without a loop that stands at the end begins at the start again.
    pub fn play(&mut self) {
        if !self.is_playing && !self.is_looping && self.num_timesteps > 1 {
            let last = self.num_timesteps - 1;
            match self.timestep() {
                0 if self.is_backwards() => self.seek(last),
                t if t == last && !self.is_backwards() => self.seek(0),
                _ => {}
            }
        }
        self.is_playing = true;
    }

    /// Stops time.
    pub fn pause(&mut self) {
        self.is_playing = false;
    }

    /// Goes to a timestep, or to the last timestep if there are fewer.
    pub fn seek(&mut self, timestep: usize) {
        self.position = timestep.min(self.num_timesteps - 1) as f64;
    }

    /// Stops time, and goes some timesteps on or back; beyond an end only in a loop.
    ///
    /// - `count`: timesteps; negative: back
    pub fn step(&mut self, count: i64) {
        self.is_playing = false;
        let (len, target) = (self.num_timesteps as i64, (self.timestep() as i64).saturating_add(count));
        self.seek(if self.is_looping { target.rem_euclid(len) } else { target.clamp(0, len - 1) } as usize);
    }

    /// Sets the speed.
    ///
    /// - `speed`: in multiples of the frame rate; negative: backwards; NaN and infinity change nothing
    pub fn set_speed(&mut self, speed: f64) {
        if speed.is_finite() {
            self.speed = speed;
        }
    }

    /// Sets whether the first timestep follows the last one, and backwards the last one the first.
    pub fn set_looping(&mut self, is_looping: bool) {
        self.is_looping = is_looping;
    }

    /// Moves the position on by the real time since the last call of this method or of [`Self::hold`].
    ///
    /// - `now_ms`: real time, milliseconds since an origin that never changes
    pub fn advance(&mut self, now_ms: f64) {
        let elapsed_ms = now_ms - self.last_ms.unwrap_or(now_ms);
        self.last_ms = Some(now_ms);
        if !self.is_playing || elapsed_ms.is_nan() || elapsed_ms <= 0.0 {
            return;
        }
        let end = self.length();
        let seconds = self.seconds() + elapsed_ms * 1e-3 * self.speed;
        if (0.0..end).contains(&seconds) || self.is_looping {
            // Rounding may give the end itself.
            let position = self.position_at(seconds.rem_euclid(end).min(end));
            self.position = if position < self.num_timesteps as f64 { position } else { 0.0 };
        } else {
            self.seek(if seconds < 0.0 { 0 } else { self.num_timesteps - 1 });
            self.is_playing = false;
        }
    }

    /// Lets real time pass without advancing the position, as while a segment is missing.
    ///
    /// - `now_ms`: as for [`Self::advance`]
    pub fn hold(&mut self, now_ms: f64) {
        self.last_ms = Some(now_ms);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn playing() -> Clock {
        let mut clock = Clock::new(10, 20.0);
        clock.advance(1000.0);
        clock.play();
        clock
    }

    #[test]
    fn time_passes_at_the_frame_rate_and_speed() {
        let mut clock = playing();
        clock.advance(1049.0);
        assert_eq!(clock.timestep(), 0);
        clock.advance(1051.0);
        assert_eq!(clock.timestep(), 1);
        clock.set_speed(0.5);
        clock.set_speed(f64::NAN);
        clock.advance(1151.0);
        assert_eq!(clock.timestep(), 2);
        clock.hold(5000.0);
        clock.advance(5050.0);
        assert!((clock.position() - 2.52).abs() < 1e-9, "{}", clock.position());
        // Real time that goes back does not move the position.
        clock.advance(4000.0);
        assert!((clock.position() - 2.52).abs() < 1e-9);
    }

    #[test]
    fn a_loop_goes_around_either_end() {
        let mut clock = playing();
        clock.advance(1525.0);
        assert_eq!(clock.timestep(), 0);
        assert!((clock.position() - 0.5).abs() < 1e-9);
        clock.set_speed(-1.0);
        clock.advance(1600.0);
        assert_eq!(clock.timestep(), 9);
        // The tab was in the background for a day.
        clock.advance(86_400_000.0);
        assert!(clock.timestep() < 10 && clock.is_playing());
    }

    #[test]
    fn without_a_loop_it_stops_at_the_end_and_play_starts_again() {
        let mut clock = playing();
        clock.set_looping(false);
        clock.advance(3000.0);
        assert_eq!((clock.timestep(), clock.is_playing()), (9, false));
        clock.play();
        assert_eq!((clock.timestep(), clock.is_playing()), (0, true));
        clock.set_speed(-2.0);
        clock.advance(4000.0);
        assert_eq!((clock.timestep(), clock.is_playing()), (0, false));
        clock.play();
        assert_eq!(clock.timestep(), 9);
    }

    /// Timesteps at 0, 0.1, 0.5 and 0.6 seconds, the last one for a twentieth.
    #[test]
    fn timesteps_are_due_at_their_times() {
        let mut clock = Clock::new(4, 20.0).with_times(vec![0.0, 0.1, 0.5, 0.6]);
        clock.advance(0.0);
        clock.play();
        let mut at = |now_ms: f64| {
            clock.advance(now_ms);
            (clock.timestep(), (clock.seconds() * 1e6).round() / 1e6)
        };
        assert_eq!(at(99.0), (0, 0.099));
        assert_eq!(at(101.0), (1, 0.101));
        assert_eq!(at(499.0), (1, 0.499));
        assert_eq!(at(501.0), (2, 0.501));
        assert_eq!(at(649.0), (3, 0.649));
        // Around the end, and a whole turn later.
        assert_eq!(at(700.0), (0, 0.05));
        assert_eq!(at(700.0 + 650.0 + 250.0), (1, 0.3));
        clock.set_speed(-2.0);
        // Backwards from 0.3 s by 0.4 s, around the start to 0.55 s.
        clock.advance(1600.0 + 200.0);
        assert_eq!(clock.timestep(), 2);
        clock.seek(2);
        assert!((clock.seconds() - 0.5).abs() < 1e-12);
        clock.set_looping(false);
        clock.set_speed(1.0);
        clock.advance(10_000.0);
        assert_eq!((clock.timestep(), clock.is_playing()), (3, false));
    }

    #[test]
    fn steps_stop_the_clock() {
        let mut clock = playing();
        clock.step(-1);
        assert_eq!((clock.timestep(), clock.is_playing()), (9, false));
        clock.step(12);
        assert_eq!(clock.timestep(), 1);
        clock.set_looping(false);
        clock.step(i64::MIN);
        assert_eq!(clock.timestep(), 0);
        clock.step(100);
        assert_eq!(clock.timestep(), 9);
        clock.seek(1000);
        assert_eq!(clock.timestep(), 9);
    }

    #[test]
    fn a_scene_of_one_timestep_stands_still() {
        let mut clock = Clock::new(1, 0.0);
        assert_eq!(clock.frame_rate(), 30.0);
        clock.play();
        clock.advance(0.0);
        clock.advance(12_345.0);
        assert_eq!(clock.timestep(), 0);
        clock.step(-3);
        assert_eq!(clock.timestep(), 0);
    }
}
