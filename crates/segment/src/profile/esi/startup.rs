//! Downloads at start: the InitCmds of a description.

use isocat_sync::object;
use isocat_wire::coe::info::Access;

use super::super::Startup;
use super::super::draft::Draft;
use super::Import;

impl Import<'_> {
    /// Those that the device's own dictionary can take in PREOP. Assignments and mappings are left to the one who
    /// configures, who writes them anyway.
    pub(super) fn startup(&mut self, draft: &Draft<'_>) -> Vec<Startup> {
        let coe = self.device.mailbox.as_ref().and_then(|mailbox| mailbox.coe.as_ref());
        let mut left_out = Vec::new();
        let mut all = Vec::new();
        for command in self.file.commands(self.device, coe) {
            let early = command.transitions.iter().any(|at| matches!(&**at, "IP" | "PS"));
            let index = command.object.index;
            let assigns = matches!(index, object::OUTPUT_ASSIGNMENT | object::INPUT_ASSIGNMENT)
                || matches!(index, 0x1600..=0x17FF | 0x1A00..=0x1BFF);
            if !early || assigns {
                continue;
            }
            let found = draft.objects.iter().find(|object| object.index == index);
            let sub = command.object.sub;
            let entry = found.and_then(|object| object.entries.iter().find(|e| e.sub == sub));
            let takes = entry.is_some_and(|entry| {
                entry.access.has(Access::WRITE_PREOP)
                    && (command.complete_access
                        || usize::from(entry.bits.div_ceil(8)) == command.data.len())
            });
            match takes {
                true => all.push(Startup {
                    object: command.object,
                    data: command.data,
                    complete_access: command.complete_access,
                }),
                false => left_out.push(command.object.to_string()),
            }
        }
        if !left_out.is_empty() {
            let why = "the dictionary of the description has no such entry to write";
            self.assume("InitCmd left out", left_out.join(" "), why);
        }
        all
    }
}
