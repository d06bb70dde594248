//! The side of the page: a player whose scene is fetched, decoded and arranged in a worker.
//!
//! Clock and tables of the file are held on both sides. The page's clock counts; the worker's stands at the timestep of
//! the page's last request. One request is under way at a time, so that a slow worker leaves timesteps out instead of
//! falling behind.

use std::rc::Rc;

use tcgs_codec::{Archive, Opening};
use tcgs_core::Camera;

use crate::clock::Clock;
use crate::error::PlayError;
use crate::player::{PlayerSettings, Tables};
use crate::start_view::StartView;
use crate::viewer::Feed;

/// A request of the page: a timestep as a camera sees it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Request {
    /// Number of the request, from 1.
    pub id: u32,
    /// The due timestep.
    pub timestep: usize,
    /// Whether playback goes backwards, for the prefetch.
    pub is_backwards: bool,
    /// Whether the first timestep follows the last one, for the prefetch.
    pub is_looping: bool,
    /// Camera of the picture; none before the start view is known.
    pub camera: Option<Camera>,
}

/// The worker's answer.
///
/// `A`: an array of words.
#[derive(Clone, Debug, Default)]
pub struct Reply<A> {
    /// Number of the last request that the worker had.
    pub id: u32,
    /// Number of bytes that have arrived of the file.
    pub bytes_loaded: u64,
    /// Why the scene does not play.
    pub failure: Option<PlayError>,
    /// The start of the file, with its tables, once.
    pub tables: Option<Vec<u8>>,
    /// The view at the start, with the first timestep.
    pub start: Option<StartView>,
    /// The timestep that was arranged.
    pub timestep: usize,
    /// Whether the due timestep was arranged with all its Gaussians.
    pub is_whole: bool,
    /// Whether the scene is drawn with antialiasing.
    pub is_antialiased: bool,
    /// [`Arranger::rows`](crate::Arranger::rows), if they changed.
    pub rows: Option<A>,
    /// [`Arranger::order`](crate::Arranger::order), if it changed.
    pub order: Option<A>,
}

/// The way to the worker and back.
pub trait Link {
    /// An array of words that came from the worker.
    type Words;

    /// Sends a request.
    fn post(&mut self, request: &Request);

    /// Takes the next answer that has arrived.
    fn take(&mut self) -> Option<Reply<Self::Words>>;
}

/// A timestep as it came from the worker.
#[derive(Debug)]
pub struct Arranged<A> {
    /// The timestep.
    pub timestep: usize,
    /// Whether it has all its Gaussians.
    pub is_whole: bool,
    /// Whether the scene is drawn with antialiasing.
    pub is_antialiased: bool,
    /// [`Arranger::rows`](crate::Arranger::rows).
    pub rows: Rc<A>,
    /// [`Arranger::order`](crate::Arranger::order).
    pub order: Rc<A>,
    /// The camera of the order, and of colours that depend on the direction of view.
    camera: Option<Camera>,
}

// Derived, it would ask for arrays that can be cloned.
impl<A> Clone for Arranged<A> {
    fn clone(&self) -> Self {
        let Self { timestep, is_whole, is_antialiased, ref rows, ref order, ref camera } = *self;
        let (rows, order) = (Rc::clone(rows), Rc::clone(order));
        Self { timestep, is_whole, is_antialiased, rows, order, camera: camera.clone() }
    }
}

/// Plays a scene that a worker fetches and decodes.
#[derive(Debug)]
pub struct RemotePlayer<L: Link> {
    link: L,
    first_timestep: usize,
    tables: Option<Tables>,
    start: Option<StartView>,
    arranged: Option<Arranged<L::Words>>,
    camera: Option<Camera>,
    /// The last request.
    asked: Request,
    is_waiting: bool,
    /// Whether the worker lacked a part of the timestep of the last request that it answered.
    is_missing: bool,
    bytes_loaded: u64,
    failure: Option<PlayError>,
}

impl<L: Link> RemotePlayer<L> {
    /// A player that has asked for nothing yet.
    ///
    /// - `link`: to a worker that opens the same scene at `first_timestep`
    pub fn new(link: L, first_timestep: usize) -> Self {
        Self {
            link,
            first_timestep,
            tables: None,
            start: None,
            arranged: None,
            camera: None,
            asked: Request::default(),
            is_waiting: false,
            is_missing: true,
            bytes_loaded: 0,
            failure: None,
        }
    }

    fn take(&mut self, reply: Reply<L::Words>) -> Result<(), PlayError> {
        self.bytes_loaded = reply.bytes_loaded;
        if let Some(failure) = reply.failure {
            return Err(failure);
        }
        if let Some(start) = reply.tables
            && let Opening::Ready(archive) = Archive::open(&start, &PlayerSettings::default().limits)?
        {
            self.tables = Tables::read(*archive, &start, self.first_timestep)?;
        }
        self.start = reply.start.or(self.start.take());
        let is_last = reply.id == self.asked.id;
        let camera = self.asked.camera.clone().filter(|_| is_last);
        if let Some(order) = reply.order {
            let held = self.arranged.take().map(|arranged| arranged.rows);
            self.arranged = reply.rows.map(Rc::new).or(held).map(|rows| Arranged {
                timestep: reply.timestep,
                is_whole: reply.is_whole,
                is_antialiased: reply.is_antialiased,
                rows,
                order: Rc::new(order),
                // An answer to an earlier request is for an unknown camera.
                camera,
            });
        } else if let Some(arranged) = self.arranged.as_mut().filter(|_| is_last && reply.is_whole) {
            // The last request wants the same rows and the same order.
            (arranged.timestep, arranged.camera) = (reply.timestep, camera);
        }
        if is_last {
            self.is_waiting = false;
            self.is_missing = !reply.is_whole || reply.timestep != self.asked.timestep;
        }
        Ok(())
    }

    /// Sends a request if the worker is idle and there is something to ask.
    fn ask(&mut self) {
        if self.is_waiting {
            return;
        }
        let clock = self.tables.as_ref().map(|tables| &tables.clock);
        let wanted = Request {
            id: self.asked.id,
            timestep: clock.map_or(self.first_timestep, Clock::timestep),
            is_backwards: clock.is_some_and(Clock::is_backwards),
            is_looping: clock.is_none_or(Clock::is_looping),
            camera: self.camera.clone(),
        };
        if wanted != self.asked || self.asked.id == 0 {
            self.asked = Request { id: wanted.id.wrapping_add(1), ..wanted };
            self.is_waiting = true;
            self.link.post(&self.asked);
        }
    }
}

impl<L: Link> Feed for RemotePlayer<L> {
    type Moment = Arranged<L::Words>;

    fn update(&mut self, now_ms: f64) -> Result<(), PlayError> {
        if let Some(failure) = &self.failure {
            return Err(failure.clone());
        }
        while let Some(reply) = self.link.take() {
            if let Err(failure) = self.take(reply) {
                self.failure = Some(failure.clone());
                return Err(failure);
            }
        }
        let is_missing = self.is_missing;
        if let Some(Tables { clock, .. }) = &mut self.tables {
            if is_missing { clock.hold(now_ms) } else { clock.advance(now_ms) }
        }
        self.ask();
        Ok(())
    }

    fn current(&self) -> Option<Self::Moment> {
        self.tables.as_ref().and(self.arranged.clone())
    }

    fn start_view(&self, _: &Self::Moment) -> StartView {
        self.start.clone().expect("it comes with the first timestep")
    }

    fn look(&mut self, camera: &Camera) {
        if self.camera.as_ref() != Some(camera) {
            self.camera = Some(camera.clone());
        }
        self.ask();
    }

    fn is_buffering(&self) -> bool {
        self.is_missing
    }

    fn is_due(&self, moment: &Self::Moment, camera: &Camera) -> bool {
        let is_of_time = self.clock().is_some_and(|clock| clock.timestep() == moment.timestep);
        moment.is_whole && is_of_time && moment.camera.as_ref() == Some(camera)
    }

    fn light(&self, moment: &Self::Moment) -> [f32; 3] {
        self.tables.as_ref().map_or([1.0; 3], |tables| tables.light.at(moment.timestep))
    }

    fn archive(&self) -> Option<&Archive> {
        self.tables.as_ref().map(|tables| &tables.archive)
    }

    fn application_data(&self) -> &[(String, Vec<u8>)] {
        self.tables.as_ref().map_or(&[], |tables| &tables.application_data)
    }

    fn clock(&self) -> Option<&Clock> {
        self.tables.as_ref().map(|tables| &tables.clock)
    }

    fn clock_mut(&mut self) -> Option<&mut Clock> {
        self.tables.as_mut().map(|tables| &mut tables.clock)
    }

    fn bytes_loaded(&self) -> u64 {
        self.bytes_loaded
    }
}
