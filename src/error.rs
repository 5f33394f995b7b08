//! The one public error type, and the warnings that travel with the nouns.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};

/// What this crate returns.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What kind of failure it is; the exit code follows from it (see [`Error::exit_code`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Kind {
    /// Wrong arguments.
    Usage,
    /// A file that cannot be opened or read.
    Unreadable,
    /// A file whose content breaks its own format.
    Malformed,
    /// A valid file that holds something that this program does not do.
    Unsupported,
    /// Two readings are equally good and the user has to choose.
    Ambiguous,
    /// Doubtful input that would give a wrong result without a word.
    Refused,
    /// An output that cannot be written.
    Unwritable,
    /// The result is worse than the user allowed; the outputs are written nevertheless.
    AboveLimit,
    /// An output that cannot be as exact as was asked for.
    Unreached,
    /// Some of many takes failed.
    Failed,
    /// The user asked to stop.
    Interrupted,
}

/// A failure with the facts that its reader needs: file, place, what was found, what was expected, what to do next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    /// The kind of failure.
    pub kind: Kind,
    /// The file it is about.
    pub file: Option<PathBuf>,
    /// The place in the file: line, byte, label or frame.
    pub place: Option<Box<str>>,
    /// What was found.
    pub found: String,
    /// What was expected instead.
    pub expected: Option<Box<str>>,
    /// What the user can do next.
    pub hint: Option<Box<str>>,
}

impl Error {
    /// An error of `kind` that says what was found.
    pub fn new(kind: Kind, found: impl Into<String>) -> Self {
        Self { kind, file: None, place: None, found: found.into(), expected: None, hint: None }
    }

    /// Shorthand for [`Kind::Malformed`].
    pub fn malformed(found: impl Into<String>) -> Self {
        Self::new(Kind::Malformed, found)
    }

    /// Shorthand for [`Kind::Refused`].
    pub fn refused(found: impl Into<String>) -> Self {
        Self::new(Kind::Refused, found)
    }

    /// A file that could not be read, with the system's reason.
    pub fn unreadable(file: &Path, reason: &std::io::Error) -> Self {
        Self::new(Kind::Unreadable, format!("cannot read: {reason}")).file(file)
    }

    /// A file that could not be written, with the system's reason.
    pub fn unwritable(file: &Path, reason: &std::io::Error) -> Self {
        Self::new(Kind::Unwritable, format!("cannot write: {reason}")).file(file)
    }

    /// Adds the file.
    #[must_use]
    pub fn file(mut self, file: impl Into<PathBuf>) -> Self {
        self.file = Some(file.into());
        self
    }

    /// Adds the place in the file: `line 12`, `byte 1044`, `label RTHI`, `frame 211`.
    #[must_use]
    pub fn at(mut self, place: impl Into<String>) -> Self {
        self.place = Some(place.into().into());
        self
    }

    /// Adds what was expected.
    #[must_use]
    pub fn expected(mut self, expected: impl Into<String>) -> Self {
        self.expected = Some(expected.into().into());
        self
    }

    /// Adds the next step for the user.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into().into());
        self
    }

    /// Adds a next step to the error for a broken file that has neither one nor what was expected.
    #[must_use]
    pub(crate) fn hint_for_broken_file(self) -> Self {
        if self.kind == Kind::Malformed && self.expected.is_none() && self.hint.is_none() {
            return self.hint("export the file again, or repair it at that place");
        }
        self
    }

    /// The exit code of the program: 2 wrong arguments, 3 refused or ambiguous, 4 a result above a limit, 130 interrupted, 1 anything else.
    pub fn exit_code(&self) -> u8 {
        match self.kind {
            Kind::Usage => 2,
            Kind::Refused | Kind::Ambiguous => 3,
            Kind::AboveLimit => 4,
            Kind::Interrupted => 130,
            _ => 1,
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(file) = &self.file {
            write!(f, "{}: ", file.display())?;
        }
        write!(f, "{}", self.found)?;
        if let Some(place) = &self.place {
            write!(f, " ({place})")?;
        }
        if let Some(expected) = &self.expected {
            write!(f, "\n   expected {expected}")?;
        }
        if let Some(hint) = &self.hint {
            write!(f, "\n   try: {hint}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Error {}

/// Warnings about doubtful input: each says what was assumed. One entry per kind, with a count in its text; never one per frame.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Notes(Vec<String>);

impl Notes {
    /// Adds a warning.
    pub fn warn(&mut self, text: impl Into<String>) {
        self.0.push(text.into());
    }

    /// Takes over the warnings of another noun.
    pub fn extend(&mut self, other: Notes) {
        self.0.extend(other.0);
    }

    /// The warnings in the order in which they arose.
    pub fn iter(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(String::as_str)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}
