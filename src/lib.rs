//! Larix turns a laser scan of a forest, with an aerial photo if there is one, into a forest
//! scene that an artist can open; it also grows single trees from species rule files.
//!
//! A scan flows through stages that are plain functions from one named type to the next. The
//! last type is a validated scene; writers turn a validated scene into bytes and decide nothing.
//! `ARCHITECTURE.md` is the map of the rooms below and of what each may know.
//!
//! Source keys used throughout: **TD17** Tkacheva & Danilin 2017, **T15** Tkacheva 2015,
//! **P18** Pyataev 2018, **ABOP** Prusinkiewicz & Lindenmayer 1990.

pub mod cache;
pub mod cli;
pub mod crown;
pub mod diagnostic;
pub mod export;
pub mod frame;
pub mod ground;
pub mod heap;
pub mod inventory;
pub mod landscape;
pub mod lod;
pub mod mesh;
pub mod pipeline;
pub mod raster;
pub mod render;
pub mod report;
pub mod scan;
pub mod scene;
pub mod seed;
pub mod simulate;
pub mod skeleton;
pub mod species;
pub mod terrain;
pub mod texture;
pub mod voxel;
pub mod work;
