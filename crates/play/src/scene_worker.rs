//! The side of the worker: a player decodes, and an arranger prepares the timestep of the page's request.

use crate::arrange::Arranger;
use crate::error::PlayError;
use crate::player::{Player, PlayerSettings};
use crate::remote::{Reply, Request};
use crate::source::RangeSource;
use crate::start_view::StartView;
use crate::viewer::Feed;

/// Answers the requests of a [`RemotePlayer`](crate::RemotePlayer) for one scene.
pub struct SceneWorker<S> {
    player: Player<S>,
    arranger: Arranger,
    request: Request,
    has_sent_tables: bool,
    /// The camera that is used until the page names one.
    start: Option<StartView>,
    failure: Option<PlayError>,
}

impl<S: RangeSource> SceneWorker<S> {
    /// - `first_timestep`: the timestep that is shown first; the last one of the scene if it has fewer
    pub fn new(source: S, settings: PlayerSettings, first_timestep: usize) -> Self {
        Self {
            player: Player::new(source, settings, first_timestep),
            arranger: Arranger::default(),
            request: Request { timestep: first_timestep, ..Request::default() },
            has_sent_tables: false,
            start: None,
            failure: None,
        }
    }

    /// Takes what the page wants from now on.
    pub fn ask(&mut self, request: Request) {
        self.request = request;
    }

    /// Takes the bytes that have arrived, decodes, and arranges what the page wants.
    ///
    /// - `now_ms`: as for [`Player::update`]
    /// - returns: the answer to the last request. Rows and order are in it only if they differ from those of the last
    ///   answer
    pub fn work(&mut self, now_ms: f64) -> Reply<&[u32]> {
        if self.failure.is_none() {
            self.failure = self.advance(now_ms).err();
        }
        let mut reply = Reply {
            id: self.request.id,
            bytes_loaded: self.player.bytes_loaded(),
            failure: self.failure.clone(),
            ..Reply::default()
        };
        if self.player.archive().is_some() && !std::mem::replace(&mut self.has_sent_tables, true) {
            reply.tables = Some(self.player.start().to_vec());
        }
        let Some(moment) = self.player.current() else { return reply };
        if self.start.is_none() {
            self.start = Some(self.player.start_view(&moment));
            reply.start.clone_from(&self.start);
        }
        let Some(camera) = self.request.camera.as_ref().or(self.start.as_ref().map(|start| &start.camera)) else {
            return reply;
        };
        let changes = self.arranger.arrange(&moment, camera);
        reply.timestep = moment.timestep;
        reply.is_whole = moment.is_whole;
        reply.is_antialiased = moment.is_antialiased();
        reply.rows = changes.has_new_rows.then(|| self.arranger.rows());
        reply.order = changes.has_new_order.then(|| self.arranger.order());
        reply
    }

    /// Whether more calls of [`Self::work`] will decode more, without any request.
    pub fn is_fetching(&self) -> bool {
        self.failure.is_none() && self.player.is_fetching()
    }

    fn advance(&mut self, now_ms: f64) -> Result<(), PlayError> {
        if let Some(clock) = self.player.clock_mut() {
            clock.seek(self.request.timestep);
            clock.set_looping(self.request.is_looping);
            clock.set_speed(if self.request.is_backwards { -1.0 } else { 1.0 });
        }
        self.player.update(now_ms)
    }
}
