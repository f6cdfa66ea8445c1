//! The plan for another MainDevice, or for the program that configures one.
//!
//! [`Sheet::of`] collects from the plan, its report and its start-up list everything that another
//! tool can use, each number with its reason. [`Tool::files`] writes the files: there is a module
//! per tool, and none computes anything beyond the sheet. A setting that a tool cannot express is a
//! comment in its file.

use isocat_engine::plan::Plan;
use isocat_segment::Scenario;

mod ethercrab;
mod igh;
mod kickcat;
mod lcec;
mod page;
mod pysoem;
mod ros2;
mod sheet;
mod soem;
mod twincat;

pub use sheet::{Device, Sheet, Unit};

/// Another MainDevice, or the program that configures one.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Tool {
    /// TwinCAT: a text that names its dialogs.
    TwinCat,
    /// The IgH EtherCAT Master: C.
    Igh,
    /// linuxcnc-ethercat: XML.
    Lcec,
    /// ethercat_driver_ros2: YAML, a file for each SubDevice.
    Ros2,
    /// SOEM 2: a program in C.
    Soem,
    /// pysoem 1.1: a program in Python.
    PySoem,
    /// ethercrab 0.7: a program in Rust.
    Ethercrab,
    /// KickCAT's Python binding 2.5: a program in Python.
    KickCat,
}

/// One file for a tool.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct File {
    /// Its name, without folder.
    pub name: String,
    /// Its content.
    pub text: String,
}

impl Tool {
    /// All tools.
    pub const ALL: [Self; 8] = [
        Self::TwinCat,
        Self::Igh,
        Self::Lcec,
        Self::Ros2,
        Self::Soem,
        Self::PySoem,
        Self::Ethercrab,
        Self::KickCat,
    ];

    /// Its name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::TwinCat => "twincat",
            Self::Igh => "igh",
            Self::Lcec => "lcec",
            Self::Ros2 => "ros2",
            Self::Soem => "soem",
            Self::PySoem => "pysoem",
            Self::Ethercrab => "ethercrab",
            Self::KickCat => "kickcat",
        }
    }

    /// The tool of this name; `None` if there is none.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|tool| tool.name() == name)
    }

    /// Whether it needs a file for each SubDevice, and so a folder.
    pub const fn many_files(self) -> bool {
        matches!(self, Self::Ros2)
    }

    /// Its files: one, or with [`many_files`](Self::many_files) one for each SubDevice.
    pub fn files(self, plan: &Plan, scenario: &Scenario) -> Vec<File> {
        let sheet = Sheet::of(plan, scenario);
        let one = |name: &str, text| vec![File { name: name.to_owned(), text }];
        match self {
            Self::TwinCat => one("twincat.txt", twincat::text(&sheet)),
            Self::Igh => one("segment.c", igh::text(&sheet)),
            Self::Lcec => one("ethercat-conf.xml", lcec::text(&sheet)),
            Self::Ros2 => ros2::files(&sheet),
            Self::Soem => one("segment.c", soem::text(&sheet)),
            Self::PySoem => one("segment.py", pysoem::text(&sheet)),
            Self::Ethercrab => one("main.rs", ethercrab::text(&sheet)),
            Self::KickCat => one("segment.py", kickcat::text(&sheet)),
        }
    }
}
