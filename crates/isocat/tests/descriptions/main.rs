//! What describes devices and segments: ESI, ENI, EEPROM contents, profiles; and damaged ones.

mod anything;
mod bench;
mod checking;
mod conform_descriptions;
mod drives;
mod eni_files;
mod eni_runs;
mod esi;
mod esi_files;
mod esi_image;
mod esi_modules;
mod esi_start_up;
mod profile;
mod profile_files;
mod profiles;
mod sii;
