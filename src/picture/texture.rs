//! Images on surfaces, in linear light.

use super::light::srgb_to_linear;
use crate::error::{Error, Result};
use glam::{Vec3, Vec4};
use std::io::Cursor;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Pixels on the longer side that are kept: pictures show a surface no larger than that.
const KEPT: usize = 1024;

/// An image that repeats in both directions.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    width: usize,
    height: usize,
    /// From the top row down.
    /// Colour and opacity.
    pixels: Vec<Vec4>,
}

impl Texture {
    /// The same linear colour everywhere.
    pub fn plain(color: [f32; 3]) -> Self {
        Self { width: 1, height: 1, pixels: vec![Vec3::from(color).extend(1.0)] }
    }

    /// The same sRGB colour everywhere.
    pub fn srgb(color: [u8; 3]) -> Self {
        Self::plain(color.map(|c| srgb_to_linear(f32::from(c) / 255.0)))
    }

    /// A PNG or JPEG file, multiplied by a linear colour. `clear`: its alpha counts.
    ///
    /// Errors: anything else.
    pub fn decode(bytes: &[u8], factor: [f32; 3], clear: bool) -> Result<Self> {
        let Bytes { width, height, channels, data } =
            if bytes.starts_with(&[0xFF, 0xD8, 0xFF]) { Bytes::of_jpeg(bytes)? } else { Bytes::of_png(bytes)? };
        let table: Vec<f32> = (0..=255u8).map(|c| srgb_to_linear(f32::from(c) / 255.0)).collect();
        let factor = Vec3::from(factor);
        let pixel = |p: &[u8]| {
            let [color, alpha] = if channels < 3 { [&[p[0]; 3], &p[1..]] } else { [&p[..3], &p[3..]] };
            let alpha = alpha.first().filter(|_| clear).map_or(1.0, |a| f32::from(*a) / 255.0);
            (Vec3::new(table[usize::from(color[0])], table[usize::from(color[1])], table[usize::from(color[2])]) * factor)
                .extend(alpha)
        };
        let pixels: Vec<Vec4> = data.chunks_exact(channels).take(width * height).map(pixel).collect();
        if pixels.len() < width * height || pixels.is_empty() {
            return Err(Error::malformed("an image that ends early"));
        }
        let mut texture = Self { width, height, pixels };
        while texture.width.max(texture.height) > KEPT {
            texture = texture.halved();
        }
        Ok(texture)
    }

    /// Means of two by two pixels.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let at = |x: usize, y: usize| self.pixels[y.min(self.height - 1) * self.width + x.min(self.width - 1)];
        let mean = |x: usize, y: usize| (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1)) * 0.25;
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| mean(2 * x, 2 * y))).collect();
        Self { width, height, pixels }
    }

    /// The colour at a place, between the four pixels around it; (0, 0) is the lower left corner of the image, (1, 1) the upper right one.
    pub(super) fn at(&self, [u, v]: [f32; 2]) -> Vec4 {
        let place = |t: f32, size: usize| {
            let t = (if t.is_finite() { t } else { 0.0 }).rem_euclid(1.0) * size as f32 - 0.5;
            let below = t.floor();
            let pixel = |i: i64| i.rem_euclid(size as i64) as usize;
            (pixel(below as i64), pixel(below as i64 + 1), t - below)
        };
        let ((x0, x1, a), (y0, y1, b)) = (place(u, self.width), place(1.0 - v, self.height));
        let row = |y: usize| self.pixels[y * self.width + x0].lerp(self.pixels[y * self.width + x1], a);
        row(y0).lerp(row(y1), b)
    }
}

/// An image as its decoder gives it.
struct Bytes {
    width: usize,
    height: usize,
    /// Bytes per pixel: gray, gray and alpha, RGB, RGBA.
    channels: usize,
    data: Vec<u8>,
}

impl Bytes {
    fn of_png(bytes: &[u8]) -> Result<Self> {
        let unreadable = |e: png::DecodingError| Error::malformed(e.to_string());
        let mut decoder = png::Decoder::new(Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::normalize_to_color8());
        let mut reader = decoder.read_info().map_err(unreadable)?;
        let size = reader.output_buffer_size().ok_or_else(|| Error::malformed("an image larger than memory"))?;
        let mut data = vec![0; size];
        let info = reader.next_frame(&mut data).map_err(unreadable)?;
        Ok(Self { width: info.width as usize, height: info.height as usize, channels: info.color_type.samples(), data })
    }

    fn of_jpeg(bytes: &[u8]) -> Result<Self> {
        let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::RGB);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
        let data = decoder.decode().map_err(|e| Error::malformed(e.to_string()))?;
        let (width, height) = decoder.dimensions().ok_or_else(|| Error::malformed("an image without a size"))?;
        Ok(Self { width, height, channels: 3, data })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::picture::Picture;

    const JPEG_SIZE: [usize; 2] = [32, 16];
    /// Red on the left, blue on the right.
    const JPEG: &[u8] = &[
        255, 216, 255, 224, 0, 16, 74, 70, 73, 70, 0, 1, 1, 0, 0, 1, 0, 1, 0, 0, 255, 219, 0, 67, 0, 13, 9, 10, 11, 10, 8, 13,
        11, 10, 11, 14, 14, 13, 15, 19, 32, 21, 19, 18, 18, 19, 39, 28, 30, 23, 32, 46, 41, 49, 48, 46, 41, 45, 44, 51, 58, 74,
        62, 51, 54, 70, 55, 44, 45, 64, 87, 65, 70, 76, 78, 82, 83, 82, 50, 62, 90, 97, 90, 80, 96, 74, 81, 82, 79, 255, 219, 0,
        67, 1, 14, 14, 14, 19, 17, 19, 38, 21, 21, 38, 79, 53, 45, 53, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79,
        79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79, 79,
        79, 79, 79, 79, 79, 79, 255, 192, 0, 17, 8, 0, 16, 0, 32, 3, 1, 17, 0, 2, 17, 1, 3, 17, 1, 255, 196, 0, 22, 0, 1, 1, 1,
        0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 5, 6, 255, 196, 0, 20, 16, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
        255, 196, 0, 22, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 7, 5, 255, 196, 0, 20, 17, 1, 0, 0, 0, 0, 0, 0, 0,
        0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 218, 0, 12, 3, 1, 0, 2, 17, 3, 17, 0, 63, 0, 207, 177, 148, 144, 16, 150, 36, 168, 5,
        212, 117, 85, 1, 9, 98, 74, 128, 127, 255, 217,
    ];

    #[test]
    fn an_image_is_read_with_its_corners_where_texture_coordinates_have_them() {
        let pixels = vec![[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]];
        let bytes = Picture { width: 2, height: 2, pixels }.png().unwrap();
        let texture = Texture::decode(&bytes, [1.0, 0.5, 1.0], true).unwrap();
        assert_eq!(texture.at([0.25, 0.75]), Vec4::new(1.0, 0.0, 0.0, 1.0), "upper left");
        assert_eq!(texture.at([0.75, 1.75]), Vec4::new(0.0, 0.5, 0.0, 1.0), "upper right, one repeat on");
        assert_eq!(texture.at([0.25, 0.25]), Vec4::new(0.0, 0.0, 1.0, 1.0));
        assert_eq!(texture.at([0.5, 0.25]), Vec4::new(0.5, 0.25, 1.0, 1.0), "between two pixels");
    }

    #[test]
    fn alpha_counts_where_it_is_asked_for() {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
        encoder.set_color(png::ColorType::GrayscaleAlpha);
        encoder.write_header().unwrap().write_image_data(&[255, 0, 0, 255]).unwrap();
        let pixels = |clear| Texture::decode(&bytes, [1.0; 3], clear).unwrap().pixels;
        assert_eq!(pixels(true), [Vec4::new(1.0, 1.0, 1.0, 0.0), Vec4::new(0.0, 0.0, 0.0, 1.0)]);
        assert_eq!(pixels(false), [Vec4::ONE, Vec4::new(0.0, 0.0, 0.0, 1.0)]);
    }

    #[test]
    fn a_jpeg_is_read_and_damaged_images_are_refused() {
        let texture = Texture::decode(JPEG, [1.0; 3], false).unwrap();
        assert_eq!((texture.width, texture.height), (JPEG_SIZE[0], JPEG_SIZE[1]));
        let [left, right] = [0.1, 0.9].map(|u| texture.at([u, 0.5]));
        assert!(left.x > 0.8 && left.z < 0.05 && right.z > 0.8 && right.x < 0.05, "{left} {right}");
        for length in 0..JPEG.len() / 2 {
            assert!(Texture::decode(&JPEG[..length], [1.0; 3], false).is_err(), "{length} bytes of it");
        }
    }

    #[test]
    fn large_images_are_made_smaller_by_means() {
        let wide: Vec<[u8; 3]> = (0..1500).map(|x| if x % 2 == 0 { [255; 3] } else { [0; 3] }).collect();
        let texture = Texture::decode(&Picture { width: 1500, height: 1, pixels: wide }.png().unwrap(), [1.0; 3], false).unwrap();
        assert_eq!((texture.width, texture.height), (750, 1));
        assert!(texture.pixels.iter().all(|p| *p == Vec4::new(0.5, 0.5, 0.5, 1.0)));
    }
}
