//! What a layer is made of: prims with properties, whatever it is written as.

/// A value that is written once.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Token(String),
    Text(String),
    Asset(String),
    Bool(bool),
    Float(f32),
    Double(f64),
    Vector3([f32; 3]),
    Vector4([f32; 4]),
    Integers(Vec<u32>),
    Floats(Vec<f32>),
    Vectors2(Vec<[f32; 2]>),
    Vectors3(Vec<[f32; 3]>),
}

impl Value {
    pub(super) fn token(text: &str) -> Self {
        Self::Token(text.to_owned())
    }
}

/// An attribute with a value in every frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Track {
    Points,
    Normals,
    Extent,
}

/// What a property says.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Content {
    /// That it is there.
    Nothing,
    Value(Value),
    Samples(Track),
    /// Path of the attribute that it takes its value from.
    Connection(String),
    /// Path of the prim that a relationship leads to.
    Target(String),
}

/// A property of a prim.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Property {
    pub(super) name: String,
    /// Its type, such as `point3f[]`; `rel` for a relationship.
    pub(super) of: &'static str,
    pub(super) uniform: bool,
    /// Whether no schema knows it.
    pub(super) custom: bool,
    pub(super) interpolation: Option<&'static str>,
    pub(super) content: Content,
}

impl Property {
    pub(super) fn new(of: &'static str, name: impl Into<String>, content: Content) -> Self {
        Self { name: name.into(), of, uniform: false, custom: false, interpolation: None, content }
    }

    pub(super) fn value(of: &'static str, name: impl Into<String>, value: Value) -> Self {
        Self::new(of, name, Content::Value(value))
    }

    pub(super) fn uniform(mut self) -> Self {
        self.uniform = true;
        self
    }

    /// A name as the scan's file has it, where an identifier cannot be that.
    pub(super) fn name_in_the_scan(name: &str) -> Self {
        let property = Self::value("string", "userProperties:name", Value::Text(name.to_owned()));
        Self { custom: true, ..property }
    }

    pub(super) fn over(mut self, interpolation: &'static str) -> Self {
        self.interpolation = Some(interpolation);
        self
    }
}

/// A prim.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Prim {
    pub(super) name: String,
    pub(super) kind: &'static str,
    /// Whether a material is bound to it or to parts of it.
    pub(super) binds: bool,
    pub(super) properties: Vec<Property>,
    pub(super) children: Vec<Prim>,
}

/// Everything but the samples.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Layer {
    /// Metadata of the layer, by name.
    pub(super) metadata: Vec<(&'static str, Value)>,
    pub(super) root: Prim,
}
