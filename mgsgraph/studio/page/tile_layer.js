// The picture of an image by tiles: those of the level that suits the zoom, coarser ones while these are on their way.

import {ask} from './app.js';

const KEPT = 400; // tiles of a picture in memory
const AT_ONCE = 6; // requests
const LATE = 200; // ms, after which it is said that pixels are being read

// Tiles that are kept and asked for; a class for each kind has their address(key)
export class Tiles {
  // `say` is called with a sentence where a tile can't be had, `changed` when one has come
  constructor(say, changed) {
    Object.assign(this, {say, changed, wanted: [], failed: false});
    this.tiles = new Map(); // key -> ImageBitmap
    this.pending = new Map(); // key -> AbortController
  }

  cancel() {
    for (const control of this.pending.values()) control.abort();
    this.pending.clear();
    this.wanted = [];
  }

  get complete() {
    return this.wanted.length === 0 && this.pending.size === 0;
  }

  get late() {
    return !this.complete && !this.failed && performance.now() - this.since >= LATE;
  }

  want(keys) {
    if (this.complete && keys.length) {
      this.since = performance.now();
      setTimeout(this.changed, LATE + 10);
    }
    const needed = new Set(keys.map(one => one.key));
    for (const [key, control] of this.pending)
      if (!needed.has(key)) {
        control.abort();
        this.pending.delete(key);
      }
    this.wanted = keys.map(one => one.key).filter(key => !this.pending.has(key));
    this.next();
  }

  next() {
    while (!this.failed && this.wanted.length && this.pending.size < AT_ONCE) {
      const key = this.wanted.shift(), control = new AbortController();
      this.pending.set(key, control);
      this.fetch(key, control);
    }
  }

  async fetch(key, control) {
    const {tiles} = this;
    try {
      const answer = await ask(this.address(key), {signal: control.signal});
      tiles.set(key, await createImageBitmap(await answer.blob()));
      while (tiles.size > KEPT) {
        const oldest = tiles.keys().next().value;
        tiles.get(oldest).close();
        tiles.delete(oldest);
      }
    } catch (error) {
      if (error.name === 'AbortError') return;
      if (error.status === 503) return void await new Promise(done => { setTimeout(done, 300); }); // too many at once
      this.failed = true;
      this.say(error.message);
    } finally {
      if (this.pending.get(key) === control) this.pending.delete(key);
      this.changed();
    }
  }
}

export class TileLayer extends Tiles {
  constructor(name, image, say, changed) {
    super(sentence => say(`${name}: ${sentence}`), changed);
    Object.assign(this, {name, image, low: image.picture.low, high: image.picture.high});
  }

  address(key) {
    const [level, row, column] = key.split('/'), {version} = this.image.picture;
    const asked = new URLSearchParams({name: this.name, level, row, column, low: this.low, high: this.high, v: version});
    return `/api/image/tile.png?${asked}`;
  }

  // Gray values that are black and white
  setContrast(low, high) {
    if (!(low < high) || (low === this.low && high === this.high)) return;
    this.low = low;
    this.high = high;
    this.stale = this.tiles; // shown until those of the new contrast are there
    this.tiles = new Map();
    this.cancel();
    this.changed();
  }

  draw(context, mapping, width, height, density) {
    const {levels, side} = this.image.picture, last = levels - 1;
    const level = Math.max(0, Math.min(last, Math.floor(Math.log2(1 / (mapping.scale * density)) + 0.25)));
    const [down, right] = mapping.bounds(width, height);
    const needed = this.keys(level, down, right, side);
    const missing = needed.filter(one => !this.tiles.has(one.key));
    const coarse = missing.length ? [last, ...[level + 2, level + 1].filter(one => one < last)] : [];
    context.save();
    context.setTransform(
      mapping.a * density, mapping.c * density, mapping.b * density, mapping.d * density,
      density * (mapping.at[0] - mapping.a * mapping.place[1] - mapping.b * mapping.place[0]),
      density * (mapping.at[1] - mapping.c * mapping.place[1] - mapping.d * mapping.place[0]),
    );
    context.beginPath();
    context.rect(0, 0, this.image.samples, this.image.lines);
    context.clip();
    context.imageSmoothingEnabled = mapping.scale * density < 3;
    const overlap = 0.7 / (mapping.scale * density);
    if (missing.length && this.stale) this.paint(context, this.keys(level, down, right, side), overlap, this.stale);
    for (const one of coarse) this.paint(context, this.keys(one, down, right, side), overlap, this.tiles);
    this.paint(context, needed, overlap, this.tiles);
    context.restore();
    if (!missing.length) this.stale = null;
    const top = this.keys(last, down, right, side).filter(one => !this.tiles.has(one.key));
    this.want([...missing, ...top]);
  }

  // Tiles of a level between lines and samples
  keys(level, down, right, side) {
    const step = side * 2 ** level, found = [];
    const rows = Math.ceil(this.image.lines / step), columns = Math.ceil(this.image.samples / step);
    const first = Math.max(0, Math.floor(down[0] / step)), end = Math.min(rows - 1, Math.floor(down[1] / step));
    const left = Math.max(0, Math.floor(right[0] / step)), stop = Math.min(columns - 1, Math.floor(right[1] / step));
    for (let row = first; row <= end; row++)
      for (let column = left; column <= stop; column++)
        found.push({key: `${level}/${row}/${column}`, row, column, step, pixel: 2 ** level});
    return found;
  }

  paint(context, keys, overlap, tiles) {
    for (const {key, row, column, step, pixel} of keys) {
      const tile = tiles.get(key);
      if (!tile) continue;
      context.drawImage(
        tile, column * step, row * step, tile.width * pixel + overlap, tile.height * pixel + overlap,
      );
    }
  }
}
