//! SoE's access to the parameters of drives: rights by state, lists, elements that an IDN does not
//! have.

use isocat_wire::AlState;
use isocat_wire::soe::{Attribute, Elements, ErrorCode, Idn};

use crate::application::Application;
use crate::description::{LIST_HEAD, Parameter};
use crate::objects::{MAX_TRANSFER, Objects};

impl<A: Application> Objects<'_, A> {
    /// Reads elements, one after the other, into the front of `target`; returns their length in
    /// bytes.
    pub fn read_elements(
        &mut self,
        drive: u8,
        idn: Idn,
        elements: Elements,
        target: &mut [u8; MAX_TRANSFER],
    ) -> Result<usize, ErrorCode> {
        let parameter = self.parameter(drive, idn)?;
        if elements == Elements::default() {
            return Err(ErrorCode::NO_ELEMENT);
        }
        let mut len = 0;
        for element in elements.each() {
            let target = &mut target[len..];
            len += match element {
                // The value is valid.
                Elements::DATA_STATE => put(&[0, 0], target)?,
                Elements::NAME if parameter.name.is_empty() => return Err(ErrorCode::NO_NAME),
                Elements::NAME => {
                    let [l0, l1] = (parameter.name.len() as u16).to_le_bytes();
                    let head = put(&[l0, l1, l0, l1], target)?;
                    head + put(parameter.name.as_bytes(), &mut target[head..])?
                }
                Elements::ATTRIBUTE => put(&parameter.attribute.0.to_le_bytes(), target)?,
                Elements::UNIT => return Err(ErrorCode::NO_UNIT),
                Elements::MINIMUM => return Err(ErrorCode::NO_MINIMUM),
                Elements::MAXIMUM => return Err(ErrorCode::NO_MAXIMUM),
                Elements::VALUE => self.read_value(parameter, target)?,
                _ => return Err(ErrorCode::NO_DEFAULT),
            };
        }
        Ok(len)
    }

    /// Writes the value of an IDN; no other element can be written.
    pub fn write_element(
        &mut self,
        drive: u8,
        idn: Idn,
        elements: Elements,
        data: &[u8],
    ) -> Result<(), ErrorCode> {
        let parameter = self.parameter(drive, idn)?;
        let other = Elements(elements.0 & !Elements::VALUE.0);
        if let Some(element) = other.each().next() {
            return Err(match element {
                Elements::NAME => ErrorCode::NAME_READ_ONLY,
                Elements::ATTRIBUTE => ErrorCode::ATTRIBUTE_READ_ONLY,
                Elements::UNIT => ErrorCode::UNIT_READ_ONLY,
                Elements::MINIMUM => ErrorCode::MINIMUM_READ_ONLY,
                Elements::MAXIMUM => ErrorCode::MAXIMUM_READ_ONLY,
                Elements::DEFAULT => ErrorCode::DEFAULT_READ_ONLY,
                _ => ErrorCode::INVALID_ELEMENT,
            });
        }
        if elements == Elements::default() {
            return Err(ErrorCode::NO_ELEMENT);
        }
        let protection = match self.state {
            AlState::SafeOp => Attribute::PROTECTED_SAFEOP,
            AlState::Op => Attribute::PROTECTED_OP,
            _ => Attribute::PROTECTED_PREOP,
        };
        if parameter.attribute.has(Attribute::READ_ONLY) {
            return Err(ErrorCode::VALUE_READ_ONLY);
        }
        if parameter.attribute.has(protection) {
            return Err(ErrorCode::VALUE_PROTECTED);
        }
        check_length(parameter, data)?;
        if parameter.fixed && !self.is_present(parameter, data) {
            return Err(ErrorCode::VALUE_INVALID);
        }
        self.application.write_parameter(drive, idn, data)?;
        let stored = self.dictionary.parameter_mut(parameter);
        stored[..data.len()].copy_from_slice(data);
        stored[data.len()..].fill(0);
        if parameter.attribute.is_list() {
            // Only the device determines how long the list can be.
            stored[2..LIST_HEAD].copy_from_slice(&parameter.list_room().to_le_bytes());
        }
        Ok(())
    }

    fn parameter(&self, drive: u8, idn: Idn) -> Result<&'static Parameter, ErrorCode> {
        let speaks = self.dictionary.description().mailbox.ok_or(ErrorCode::GENERAL)?.speaks;
        if drive >= speaks.drives {
            return Err(ErrorCode::DRIVE_NUMBER);
        }
        let all = speaks.parameters;
        let at = all.binary_search_by_key(&(drive, idn), |one| (one.drive, one.idn));
        at.ok().and_then(|at| all.get(at)).ok_or(ErrorCode::NO_IDN)
    }

    fn read_value(&mut self, parameter: &Parameter, target: &mut [u8]) -> Result<usize, ErrorCode> {
        let room = usize::from(parameter.len).min(target.len());
        if let Some(given) =
            self.application.read_parameter(parameter.drive, parameter.idn, &mut target[..room])
        {
            return given.map(|bytes| bytes.min(room));
        }
        put(self.dictionary.parameter(parameter), target)
    }

    /// Whether a value is the present one.
    fn is_present(&self, parameter: &Parameter, data: &[u8]) -> bool {
        let present = self.dictionary.parameter(parameter);
        if !parameter.attribute.is_list() {
            return present == data;
        }
        // The largest length of a list is not part of its value.
        present[..2] == data[..2] && present[LIST_HEAD..] == data[LIST_HEAD..]
    }
}

/// Checks that a value has the length of the parameter, or that a list fits.
fn check_length(parameter: &Parameter, data: &[u8]) -> Result<(), ErrorCode> {
    let len = usize::from(parameter.len);
    if !parameter.attribute.is_list() {
        return match data.len() {
            short if short < len => Err(ErrorCode::VALUE_TOO_SHORT),
            long if long > len => Err(ErrorCode::VALUE_TOO_LONG),
            _ => Ok(()),
        };
    }
    let Some((&[l0, l1, ..], items)) = data.split_first_chunk::<LIST_HEAD>() else {
        return Err(ErrorCode::VALUE_TOO_SHORT);
    };
    let said = usize::from(u16::from_le_bytes([l0, l1]));
    if said > items.len() || !said.is_multiple_of(parameter.attribute.length()) {
        Err(ErrorCode::VALUE_TOO_SHORT)
    } else if said < items.len() || data.len() > len {
        Err(ErrorCode::VALUE_TOO_LONG)
    } else {
        Ok(())
    }
}

fn put(bytes: &[u8], target: &mut [u8]) -> Result<usize, ErrorCode> {
    target.get_mut(..bytes.len()).ok_or(ErrorCode::GENERAL)?.copy_from_slice(bytes);
    Ok(bytes.len())
}
