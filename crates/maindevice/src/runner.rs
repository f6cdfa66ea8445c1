//! A MainDevice with its application: the calls after each input.

use isocat_wire::time::{Host, Time};

use crate::application::Application;
use crate::event::Event;
use crate::machine::MainDevice;
use crate::ring::Port;

/// Runs a [`MainDevice`] and an [`Application`] on it, in virtual time as well as on a wire.
///
/// - Input: [`handle_frame`](Self::handle_frame), [`handle_timeout`](Self::handle_timeout). If the
///   input completes a cycle, they call the application and return the cycle's number.
/// - Output, to be drained after each input or request: [`poll_event`](Self::poll_event), which
///   passes events to the application first, and [`poll_transmit`](Self::poll_transmit), with
///   [`poll_secondary`](Self::poll_secondary) after each frame in a ring; then
///   [`next_timeout`](Self::next_timeout) again.
/// - Requests: [`main_mut`](Self::main_mut).
pub struct Runner<A> {
    main: MainDevice,
    application: A,
}

impl<A: Application> Runner<A> {
    /// A new machine with its application.
    pub fn new(main: MainDevice, application: A) -> Self {
        Self { main, application }
    }

    /// Takes a frame received at a port, as [`MainDevice::handle_frame_at`]. Returns the number of
    /// the cycle that it completed; the application has been called for it if process data run.
    pub fn handle_frame(&mut self, port: Port, now: Time<Host>, frame: &[u8]) -> Option<u64> {
        self.main.handle_frame_at(port, now, frame);
        self.main.poll_cycle(&mut self.application)
    }

    /// Passes the time, as [`MainDevice::handle_timeout`]. Returns the number of the cycle that
    /// ends with it; the application has been called for it if process data run.
    pub fn handle_timeout(&mut self, now: Time<Host>) -> Option<u64> {
        self.main.handle_timeout(now);
        self.main.poll_cycle(&mut self.application)
    }

    /// Takes the next event; the application has seen it.
    pub fn poll_event(&mut self) -> Option<Event> {
        let event = self.main.poll_event()?;
        self.application.event(&event);
        Some(event)
    }

    /// See [`MainDevice::poll_transmit`].
    pub fn poll_transmit(&mut self, now: Time<Host>, buffer: &mut [u8]) -> Option<usize> {
        self.main.poll_transmit(now, buffer)
    }

    /// See [`MainDevice::poll_secondary`].
    pub fn poll_secondary(&mut self, buffer: &mut [u8]) -> Option<usize> {
        self.main.poll_secondary(buffer)
    }

    /// See [`MainDevice::next_timeout`].
    pub fn next_timeout(&self) -> Option<Time<Host>> {
        self.main.next_timeout()
    }

    /// The MainDevice, for requests; drain its output afterwards.
    pub fn main_mut(&mut self) -> &mut MainDevice {
        &mut self.main
    }

    /// The application.
    pub fn application_mut(&mut self) -> &mut A {
        &mut self.application
    }

    /// Returns both parts.
    pub fn into_parts(self) -> (MainDevice, A) {
        (self.main, self.application)
    }

    /// The MainDevice.
    pub fn main(&self) -> &MainDevice {
        &self.main
    }

    /// The application.
    pub fn application(&self) -> &A {
        &self.application
    }
}
