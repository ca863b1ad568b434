//! Pictures become an animated GIF, or go to ffmpeg, which makes an mp4 of them.

use super::picture::{Canvas, Colour, PALETTE};
use super::{HEIGHT, PICTURE_CS, WIDTH};
use anyhow::{Context, Error, Result, anyhow, bail};
use gif::{DisposalMethod, Encoder, Frame, Repeat};
use std::borrow::Cow;
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};

/// The program that makes an mp4.
const FFMPEG: &str = "ffmpeg";

const NOT_WRITTEN: &str = "the film cannot be written";

fn not_made(why: impl std::fmt::Display) -> Error {
    anyhow!("ffmpeg did not make the film: {why}")
}

/// An animated GIF: only what changed is written.
pub struct Gif {
    encoder: Encoder<Vec<u8>>,
    shown: Option<Canvas>,
}

impl Gif {
    /// Begins it.
    pub fn begin() -> Result<Self> {
        let palette: Vec<u8> = PALETTE.iter().flatten().copied().collect();
        let mut encoder = Encoder::new(Vec::new(), WIDTH as u16, HEIGHT as u16, &palette).context(NOT_WRITTEN)?;
        encoder.set_repeat(Repeat::Infinite).context(NOT_WRITTEN)?;
        Ok(Self { encoder, shown: None })
    }

    /// Takes a picture that is shown for so many hundredths of a second.
    pub fn picture(&mut self, canvas: &Canvas, delay_cs: u16) -> Result<()> {
        let frame = difference(self.shown.as_ref(), canvas, delay_cs);
        self.encoder.write_frame(&frame).context(NOT_WRITTEN)?;
        self.shown = Some(canvas.clone());
        Ok(())
    }

    /// The file's content.
    pub fn finish(self) -> Result<Vec<u8>> {
        self.encoder.into_inner().context(NOT_WRITTEN)
    }
}

/// What changed since the last picture, as the smallest rectangle around it; pixels in it that did not change are transparent.
fn difference(before: Option<&Canvas>, now: &Canvas, delay: u16) -> Frame<'static> {
    let whole = (0, 0, WIDTH, HEIGHT);
    let (left, top, right, bottom) = before.map_or(whole, |before| {
        let changed = || (0..WIDTH * HEIGHT).filter(|i| before.pixels[*i] != now.pixels[*i]);
        let row = |i: Option<usize>| i.map_or(0, |i| i / WIDTH);
        let (top, bottom) = (row(changed().next()), row(changed().next_back()));
        let (left, right) = changed().fold((WIDTH - 1, 0), |(l, r), i| (l.min(i % WIDTH), r.max(i % WIDTH)));
        (left.min(right), top, right + 1, bottom + 1)
    });
    let mut buffer = Vec::with_capacity((right - left) * (bottom - top));
    for y in top..bottom {
        for x in left..right {
            let i = y * WIDTH + x;
            let same = before.is_some_and(|before| before.pixels[i] == now.pixels[i]);
            buffer.push(if same { Colour::TRANSPARENT } else { now.pixels[i] });
        }
    }
    Frame {
        delay,
        dispose: DisposalMethod::Keep,
        transparent: Some(Colour::TRANSPARENT),
        left: left as u16,
        top: top as u16,
        width: (right - left) as u16,
        height: (bottom - top) as u16,
        buffer: Cow::Owned(buffer),
        ..Frame::default()
    }
}

/// An mp4 (H.264), which ffmpeg makes. One that is not finished is removed.
pub struct Video {
    ffmpeg: Child,
    pictures: Option<ChildStdin>,
    file: PathBuf,
    /// What ffmpeg writes, until it is whole.
    part: PathBuf,
    /// A picture as red, green, blue.
    bytes: Vec<u8>,
}

impl Video {
    /// Whether there is a program that makes it.
    pub fn check() -> Result<()> {
        match Command::new(FFMPEG).arg("-version").output() {
            Ok(said) if said.status.success() => Ok(()),
            Err(error) if error.kind() == ErrorKind::NotFound => bail!(
                "an mp4 is made by the program ffmpeg, and there is none on the path: install it, or give the film a name that ends in .gif"
            ),
            Ok(said) => Err(not_made(format!("`ffmpeg -version` ended with {}", said.status))),
            Err(error) => Err(not_made(error)),
        }
    }

    /// Begins it, in the place of a file that may be there.
    pub fn begin(file: &Path) -> Result<Self> {
        let pictures_per_s = 100 / PICTURE_CS;
        let part = file.with_extension("mp4.part");
        // What every player shows, and a browser before it has the whole file.
        let arguments = format!(
            "-loglevel error -y -f rawvideo -pixel_format rgb24 -video_size {WIDTH}x{HEIGHT} -framerate {pictures_per_s} -i - \
             -c:v libx264 -pix_fmt yuv420p -movflags +faststart -f mp4"
        );
        let mut command = Command::new(FFMPEG);
        command.args(arguments.split(' ')).arg(&part);
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let mut ffmpeg = command.spawn().map_err(not_made)?;
        let pictures = ffmpeg.stdin.take();
        Ok(Self {
            ffmpeg,
            pictures,
            file: file.to_owned(),
            part,
            bytes: vec![0; WIDTH * HEIGHT * 3],
        })
    }

    /// Takes a picture that is shown for so many hundredths of a second.
    pub fn picture(&mut self, canvas: &Canvas, delay_cs: u16) -> Result<()> {
        for (rgb, colour) in self.bytes.chunks_exact_mut(3).zip(&canvas.pixels) {
            rgb.copy_from_slice(&PALETTE[usize::from(*colour) % PALETTE.len()]);
        }
        for _ in 0..(delay_cs / PICTURE_CS).max(1) {
            if let Some(Err(_)) = self.pictures.as_mut().map(|pipe| pipe.write_all(&self.bytes)) {
                // It ended early, and says why.
                let why = self.end().unwrap_or_else(|| "it ended early".to_owned());
                return Err(not_made(why));
            }
        }
        Ok(())
    }

    /// Waits for the file.
    pub fn finish(mut self) -> Result<()> {
        match self.end() {
            None => std::fs::rename(&self.part, &self.file).map_err(not_made),
            Some(why) => Err(not_made(why)),
        }
    }

    /// Closes the pipe; what went wrong, if something did.
    fn end(&mut self) -> Option<String> {
        self.pictures = None;
        let mut said = String::new();
        // A second time there is nothing more to read, and the same end.
        if let Some(mut stderr) = self.ffmpeg.stderr.take() {
            // What is no text is not shown.
            let _ = stderr.read_to_string(&mut said);
        }
        match self.ffmpeg.wait() {
            Ok(status) if status.success() => None,
            Ok(status) => Some(match said.trim() {
                "" => status.to_string(),
                said => said.to_owned(),
            }),
            Err(error) => Some(error.to_string()),
        }
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        self.end();
        // Half a film; a whole one has its name by now.
        let _ = std::fs::remove_file(&self.part);
    }
}
