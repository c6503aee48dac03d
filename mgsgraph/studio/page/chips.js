// Chips of a point's measurements: the same ground at one scale, turned as in the first image where the geometry is known.

import {Affine, ofFrame, ofOther} from './affine.js';
import {ask} from './app.js';
import {drawTies} from './image_marks.js';
import {make, prepared} from './plot.js';

const HALF = 96; // pixels from the middle pixel to the edges, as the server cuts them
let zoom = 2; // CSS pixels for a pixel of the first chip; the same for the next point

export class Chips {
  constructor(app) {
    Object.assign(this, {app, all: [], others: {}});
  }

  // The canvas of a measurement
  of(ray) {
    const canvas = make('canvas', {className: 'chip', tabIndex: 0, role: 'img', ariaLabel: `Pixels around the measurement in ${ray.image}`});
    canvas.title = `${ray.image}: wheel, + and − zoom all chips`;
    const chip = {ray, canvas}, zoomed = event => {
      const factor = event.deltaY ? Math.exp(-event.deltaY / 400) : {'+': 1.25, '=': 1.25, '-': 0.8}[event.key];
      if (!factor) return;
      event.preventDefault();
      zoom = Math.max(1, Math.min(8, zoom * factor));
      this.draw();
    };
    canvas.addEventListener('wheel', zoomed, {passive: false});
    canvas.addEventListener('keydown', zoomed);
    new ResizeObserver(() => this.draw()).observe(canvas);
    this.all.push(chip);
    this.app.orSay(this.read(chip));
    return canvas;
  }

  async read(chip) {
    const {image, line, sample} = chip.ray, [{ray: first}] = this.all;
    const answer = await ask(`/api/chip.png?${new URLSearchParams({image, line, sample})}`);
    chip.pixels = await createImageBitmap(await answer.blob());
    if (chip.ray !== first) {
      const asked = new URLSearchParams({name: first.image, line: first.line, sample: first.sample, with: image});
      Object.assign(this.others, (await this.app.request(`/api/image/ground?${asked}`)).others);
    }
    this.draw();
  }

  mapping({ray, canvas}) {
    const [{ray: first}] = this.all, frame = ofFrame([first.line, first.sample], zoom, [1, 0, 0, 1], canvas.clientWidth, canvas.clientHeight);
    const other = this.others[ray.image];
    const linked = other && ray !== first && ofOther(frame, first, {...ray, jacobian: other.jacobian});
    return linked || new Affine([ray.line, ray.sample], frame.at, zoom, 0, 0, zoom);
  }

  draw() {
    for (const chip of this.all) {
      const {ray, canvas, pixels} = chip, {context, width, height, density} = prepared(canvas);
      if (!pixels || !width) continue;
      const mapping = this.mapping(chip), [x, y] = mapping.at, {a, b, c, d} = mapping;
      const left = Math.floor(ray.sample) - HALF - ray.sample, top = Math.floor(ray.line) - HALF - ray.line;
      context.fillStyle = '#000000';
      context.fillRect(0, 0, width, height);
      context.imageSmoothingEnabled = false;
      context.transform(a, c, b, d, x, y);
      context.drawImage(pixels, left, top);
      context.setTransform(density, 0, 0, density, 0, 0);
      // the mark at the measurement; its line ends where the geometry puts the point
      drawTies(context, mapping, {measured: [[ray.line, ray.sample]], residuals: [ray.residual_px], used: [ray.used], names: ['']}, [{k: 0, x, y}], -1);
    }
  }
}
