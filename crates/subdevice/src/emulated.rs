//! A device without a program. The ESC answers AL control itself (device emulation), and digital
//! I/O is connected to its memory. The stack represents that circuit: it follows AL status, drives
//! outputs and latches inputs, and it cannot check or refuse a configuration.

use isocat_esc::{Pdi, PdiExt};
use isocat_sync::{Chain, SyncMode};
use isocat_wire::register::{self, al_event};
use isocat_wire::time::{Device, Time};
use isocat_wire::{AlState, Nanos};

use crate::application::Application;
use crate::checks;
use crate::description::ProcessDataArea;
use crate::process_data::{Buffer, Buffers};
use crate::stack::SubDevice;
use crate::sync_engine::Setup;

impl<A: Application, S: AsRef<[u8]> + AsMut<[u8]>> SubDevice<A, S> {
    /// Whether there is no program behind the ESC.
    pub(crate) fn is_emulated(&self) -> bool {
        self.description().behaviour.device_emulation
    }

    /// Follows AL status, and checks whether the watchdog has expired.
    pub(crate) fn follow(&mut self, now: Time<Device>, pdi: &mut impl Pdi) {
        if pdi.events() & al_event::WATCHDOG != 0 {
            // Reading the status releases the event.
            let _status = pdi.load(register::WATCHDOG_STATUS);
            if self.esm.state == AlState::Op {
                self.application.safe_outputs();
            }
        }
        let Ok(state) = pdi.load(register::AL_STATUS).state() else { return };
        let before = self.esm.state;
        if state == before {
            return;
        }
        let was_cyclic = self.esm.is_cyclic();
        self.esm.state = state;
        if before == AlState::Op {
            self.application.safe_outputs();
        }
        match (was_cyclic, self.esm.is_cyclic()) {
            (false, true) => self.begin_exchange(now, pdi),
            (true, false) => {
                self.sync.stop();
                self.process_data.stop();
            }
            _ => {}
        }
    }

    /// Starts the exchange. Outputs and inputs are at the circuit's wired addresses, independent of
    /// the SyncManagers.
    fn begin_exchange(&mut self, now: Time<Device>, pdi: &mut impl Pdi) {
        let outputs = wired(self.description().output_areas());
        let inputs = wired(self.description().input_areas());
        let setup = self.wired_to(outputs.is_used(), inputs.is_used(), pdi);
        self.sync.start(now, setup);
        self.process_data.start(outputs, inputs, self.dictionary.images_mut());
        self.first_exchange(pdi);
    }

    /// The circuit's synchronization: SYNC0 moves the outputs if its pulses run and the circuit
    /// uses them; otherwise each exchange does.
    fn wired_to(&mut self, has_outputs: bool, has_inputs: bool, pdi: &mut impl Pdi) -> Setup {
        let by_pulses =
            checks::sync(pdi, &self.dictionary.values(), self.chosen, has_outputs, has_inputs);
        by_pulses.ok().filter(|setup| setup.chain.mode.uses_dc()).unwrap_or(Setup {
            chain: Chain {
                mode: SyncMode::SmSynchronous,
                has_outputs,
                polls_outputs: false,
                outputs_on_sync1: false,
                application_on_sync1: false,
            },
            cycle: Nanos::ZERO,
            sync1: Nanos::ZERO,
            has_inputs,
            acknowledge_sync: false,
        })
    }
}

fn wired(areas: impl Iterator<Item = ProcessDataArea>) -> Buffers {
    let mut buffers = Buffers::NONE;
    for (number, area) in areas.enumerate() {
        buffers.set(number, Buffer { start: area.start, length: area.max_length });
    }
    buffers
}
