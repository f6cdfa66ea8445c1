//! ESI: device descriptions by vendors (ETG.2000), read into plain values.
//!
//! Bytes become text (`decode`), text a tree (`tree`, which limits the effort for a file), and the
//! tree an [`EsiFile`] of [`EsiDevice`]s. Every value keeps its byte offset, so that later errors
//! can name its place. There are three kinds of problems:
//!
//! * A file that is not well-formed, or exceeds a limit, is refused as a whole: a [`FileError`]
//!   with line and column. Nothing of it is imported.
//! * A device that can't be read (a broken number, say) is refused with its place; its neighbours
//!   stay: [`EsiFile::refused`].
//! * A part that can be read in more than one way is read in one of them, and a [`Warning`] of a
//!   fixed name says which.
//!
//! ```
//! use isocat_descriptions::esi::EsiFile;
//! let text = br##"<EtherCATInfo><Vendor><Id>#x1</Id><Name>Nobody</Name></Vendor><Descriptions><Groups/>
//!     <Devices><Device Physics="YY"><Type ProductCode="#x2" RevisionNo="3">Box</Type></Device></Devices>
//!     </Descriptions></EtherCATInfo>"##;
//! let file = EsiFile::from_bytes("box.xml", text).unwrap();
//! assert_eq!(file.devices[0].product_code, Some(2));
//! assert!(file.warnings().any(|(_, warning)| warning.kind.name() == "group-unknown"));
//! ```

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::hash::{Hash, Hasher};
use std::sync::OnceLock;

use crate::document::{FileError, Source, Wrong};
use crate::limits;

mod choice;
mod dc;
mod decode;
mod device;
mod dictionary;
mod eeprom;
mod fitting;
mod image;
mod mailbox;
mod module_choice;
mod modules;
mod numbers;
mod pdo;
mod read;
mod registers;
mod sii;
mod slots;
mod sync_manager;
mod tree;
mod warning;

pub use choice::{Choice, NoChoice, Wanted, Wish};
pub use dc::{CycleTime, EsiDc, EsiOpMode, OpModeAssignment, ShiftTime};
pub use decode::Encoding;
pub use device::{EsiDevice, EsiGroup};
pub use dictionary::{EsiEntry, EsiObject, EsiProfile};
pub use eeprom::{EsiEeprom, EsiTimeouts};
pub use fitting::FittedModule;
pub use image::Image;
pub use mailbox::{EsiCoe, EsiMailbox, EsiSoe, IdnCommand, InitCommand};
pub use module_choice::{ModuleName, ModuleWish, NoModule, SlotName, WishPart};
pub use modules::{EsiModule, ModuleAt};
pub use pdo::{Direction, EsiPdo, EsiPdoEntry};
pub use registers::EsiRegisters;
pub use sii::{EsiImage, ImageNote};
pub use slots::{EsiPdoGroup, EsiPlace, EsiSlot, EsiSlots, Follows, Increments, ModuleClass};
pub use sync_manager::{EsiSyncManager, Purpose};
pub(crate) use tree::guard;
use tree::{Element, Malformed, Problem};
use warning::Warnings;
pub use warning::{Warning, WarningKind};

/// The content of a description.
#[derive(Clone, Debug)]
pub struct EsiFile {
    /// The name of the file in errors.
    pub path: String,
    /// Encoding of its bytes.
    pub encoding: Encoding,
    /// `Vendor/Id`; 0 for a file of modules, which may have none.
    pub vendor_id: u32,
    /// `Vendor/Name`.
    pub vendor: String,
    /// Devices in the order of the file.
    pub devices: Vec<EsiDevice>,
    /// Modules in the order of the file.
    pub modules: Vec<EsiModule>,
    /// Devices and modules that could not be read, each with its place.
    pub refused: Vec<FileError>,
    /// Other files that it refers to (`InfoReference`), as written; they are not read.
    pub references: Vec<String>,
    /// Doubts about the file as a whole.
    pub file_warnings: Vec<Warning>,
    text: String,
    /// Byte offset of each line, computed when the first place is requested.
    lines: OnceLock<Vec<usize>>,
    /// Fingerprints of the files whose modules were added.
    other_texts: Vec<u64>,
}

/// A place in a file: line and column, both from 1.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub struct Place {
    /// Line.
    pub line: usize,
    /// Column in characters.
    pub column: usize,
}

impl EsiFile {
    /// Reads a file from disk, of at most [`limits::XML`] bytes.
    pub fn read(path: &str) -> Result<Self, FileError> {
        Self::from_bytes(path, &limits::read(path, limits::XML)?)
    }

    /// Reads the bytes of a file; `path` names it in errors.
    pub fn from_bytes(path: &str, bytes: &[u8]) -> Result<Self, FileError> {
        limits::check(path, bytes.len(), limits::XML)?;
        let decoded = decode::decode(bytes).map_err(|error| {
            FileError::new(Wrong {
                path: path.to_owned(),
                line: error.line,
                column: error.column,
                message: error.message,
                hint: None,
            })
        })?;
        // XML normalizes line ends. Places do not change, and the parser is faster without the
        // search.
        let text = match decoded.text.contains('\r') {
            true => Cow::Owned(decoded.text.replace("\r\n", "\n")),
            false => decoded.text,
        };
        let source = Source { path, text: &text };
        let document = tree::parse(&text).map_err(|error| match error {
            Malformed::At(Problem { at, message }) => source.error(at, message),
            Malformed::Place(line, column, message) => {
                FileError::new(Wrong { path: path.to_owned(), line, column, message, hint: None })
            }
        })?;
        let mut warnings = Warnings::default();
        match decoded.doubt {
            Some(decode::Doubt::Name(name)) => {
                warnings.add(WarningKind::EncodingName, 0, || {
                    format!(
                        "\"{name}\" is no registered name; {} is taken",
                        decoded.encoding.name()
                    )
                });
            }
            Some(decode::Doubt::Contradiction(what)) => {
                warnings.add(WarningKind::EncodingMismatch, 0, || what);
            }
            None => {}
        }
        let mut file = Self {
            path: path.to_owned(),
            encoding: decoded.encoding,
            vendor_id: 0,
            vendor: String::new(),
            devices: Vec::new(),
            modules: Vec::new(),
            refused: Vec::new(),
            references: Vec::new(),
            file_warnings: Vec::new(),
            text: String::new(),
            lines: OnceLock::new(),
            other_texts: Vec::new(),
        };
        let mut refused = Vec::new();
        let content = file.content(Element::root(&document), &mut warnings, &mut refused);
        drop(document);
        content.map_err(|Problem { at, message }| source.error(at, message))?;
        file.text = text.into_owned();
        file.refused =
            refused.into_iter().map(|problem| file.error(problem.at, problem.message)).collect();
        file.file_warnings = warnings.0;
        Ok(file)
    }

    fn content(
        &mut self,
        root: Element<'_>,
        warnings: &mut Warnings,
        refused: &mut Vec<Problem>,
    ) -> Result<(), Problem> {
        // A file of modules has its list at the top level.
        let (is_module_file, descriptions) = match root.name() {
            "EtherCATInfo" => (false, root.child("Descriptions")),
            "EtherCATModule" => (true, Some(root.child("Descriptions").unwrap_or(root))),
            other => {
                let message = format!("the root is <{other}>; expected <EtherCATInfo>");
                return Err(Problem::new(root.at(), message));
            }
        };
        let vendor = root.child("Vendor");
        match vendor {
            Some(vendor) => {
                self.vendor_id = read::required(vendor, "Id", read::U32, warnings)? as u32;
                self.vendor = read::name(vendor);
                if self.vendor.is_empty() {
                    warnings.add(WarningKind::VendorNameMissing, vendor.at(), || {
                        format!("vendor {:#x} has no name", self.vendor_id)
                    });
                }
            }
            None if !is_module_file => {
                return Err(Problem::new(root.at(), "the file lacks <Vendor>; expected its Id"));
            }
            None => {}
        }
        for reference in root.children("InfoReference") {
            warnings.add(WarningKind::ReferencedFileNotRead, reference.at(), || {
                format!("\"{}\"", read::cut(&reference.text()))
            });
            if self.references.len() < MOST_REFERENCES {
                self.references.push(read::cut(&reference.text()));
            }
        }
        let Some(descriptions) = descriptions else {
            let message = "the file lacks <Descriptions>; expected devices or modules in it";
            return Err(Problem::new(root.at(), message));
        };
        let mut left = MOST_ENTRIES;
        if let Some(list) = descriptions.child("Modules") {
            self.modules = modules::modules(list, self.vendor_id, &mut left, warnings, refused);
        }
        let groups: HashMap<String, String> = descriptions
            .child("Groups")
            .iter()
            .flat_map(|groups| groups.children("Group"))
            .map(|group| (group.child_text("Type").into_owned(), read::name(group)))
            .collect();
        let definitions = pdo::Definitions::of(descriptions);
        let list = descriptions.child("Devices");
        for element in list.iter().flat_map(|list| list.children("Device")) {
            if self.devices.len() == MOST_DEVICES {
                let message = format!("more than {MOST_DEVICES} devices; the rest is not read");
                refused.push(Problem::new(element.at(), message));
                break;
            }
            match device::read(element, &groups, &definitions, &self.modules, &mut left) {
                Ok(device) => self.devices.push(device),
                Err(problem) => refused.push(problem),
            }
        }
        self.compare(list);
        Ok(())
    }

    /// Checks that need all devices: hidden ones and repeated ones.
    fn compare(&mut self, list: Option<Element<'_>>) {
        let mut hidden = HashSet::new();
        for element in list.iter().flat_map(|list| list.children("Device")) {
            for hide in element.children("HideType") {
                let mut ignored = Warnings::default();
                let mut number =
                    |name| read::attribute(hide, name, read::U32, &mut ignored).ok()?;
                if let Some(revision) = number("RevisionNo") {
                    let product = number("ProductCode").map(|code| code as u32);
                    hidden.insert((hide.text().into_owned(), product, revision as u32));
                }
            }
        }
        let mut first: HashMap<(u32, Option<u32>), usize> = HashMap::new();
        for (place, device) in self.devices.iter_mut().enumerate() {
            let key = |product| (device.type_name.clone(), product, device.revision.unwrap_or(0));
            device.hidden =
                hidden.contains(&key(None)) || hidden.contains(&key(device.product_code));
            let Some(product) = device.product_code else { continue };
            if first.insert((product, device.revision), place).is_some() {
                let mut warnings = Warnings(std::mem::take(&mut device.warnings));
                warnings.add(WarningKind::IdentityRepeated, device.at, || {
                    format!("product {product:#x} with this revision stands before, too")
                });
                device.warnings = warnings.0;
            }
        }
    }

    /// Adds the modules of another file; its devices are ignored. Later doubts about these modules
    /// are reported at the slot with the module.
    pub fn add_modules(&mut self, other: Self) {
        self.other_texts.push(other.fingerprint());
        let own = |file: Option<String>| Some(file.unwrap_or_else(|| other.path.clone()));
        let modules = other.modules.into_iter();
        self.modules.extend(modules.map(|module| EsiModule { file: own(module.file), ..module }));
        self.refused.extend(other.refused);
    }

    /// The decoded text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// A hash that distinguishes texts of the same path.
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = std::hash::DefaultHasher::new();
        self.text.hash(&mut hasher);
        self.other_texts.hash(&mut hasher);
        hasher.finish()
    }

    /// Line and column of a byte offset.
    pub fn place(&self, at: usize) -> Place {
        let lines = self.lines.get_or_init(|| line_starts(&self.text));
        let line = lines.partition_point(|start| *start <= at);
        let start = lines.get(line.wrapping_sub(1)).copied().unwrap_or(0);
        let before = self.text.get(start..at).unwrap_or_default();
        Place { line: line.max(1), column: before.chars().count() + 1 }
    }

    /// An error at a byte offset of the text.
    pub fn error(&self, at: usize, message: impl Into<String>) -> FileError {
        let Place { line, column } = self.place(at);
        FileError::new(Wrong {
            path: self.path.clone(),
            line,
            column,
            message: message.into(),
            hint: None,
        })
    }

    /// All warnings: those of the file, then those of each device.
    pub fn warnings(&self) -> impl Iterator<Item = (Option<&EsiDevice>, &Warning)> {
        let of_file = self.file_warnings.iter().map(|warning| (None, warning));
        let of_devices = self
            .devices
            .iter()
            .flat_map(|device| device.warnings.iter().map(move |warning| (Some(device), warning)));
        of_file.chain(of_devices)
    }
}

/// The code of a data type by its name in PDOs; if the name is unknown or does not fit, by its
/// bits.
pub fn data_type(name: &str, bits: u32) -> isocat_wire::coe::DataType {
    dictionary::by_name(name, bits).unwrap_or_else(|| dictionary::by_bits(bits))
}

fn line_starts(text: &str) -> Vec<usize> {
    let newlines = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n');
    std::iter::once(0).chain(newlines.map(|(at, _)| at + 1)).collect()
}

/// The largest known file has 147.
const MOST_DEVICES: usize = 10_000;
/// Largest number of references that are kept.
const MOST_REFERENCES: usize = 16;
/// Limit of the entries of all dictionaries together: some 100 MB.
const MOST_ENTRIES: usize = 1_000_000;
