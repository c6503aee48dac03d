// Black and white of a picture: a window on its histogram, moved by its two handles, as a whole, or set by buttons.

import {button, make, pageColors, prepared, short} from './plot.js';

const SOON = 120; // ms without a further step, after which tiles are asked for

export class Contrast {
  constructor(pane, picture) {
    const {first, step, counts, least, most, low, high} = picture;
    Object.assign(this, {pane, picture, window: [low, high], ends: [first, first + step * counts.length]});
    const span = this.ends[1] - first, oninput = () => this.set(this.handles.map(one => Number(one.value)));
    this.handles = ['Black', 'White'].map(title => make('input', {type: 'range', min: first, max: this.ends[1], step: 'any', title, ariaLabel: title, oninput}));
    this.canvas = make('canvas', {className: 'histogram', title: 'Drag to move the window'});
    this.canvas.onpointerdown = event => this.canvas.setPointerCapture(event.pointerId);
    this.canvas.onpointermove = event => event.buttons && this.set(this.window.map(one => one + event.movementX * span / this.canvas.clientWidth));
    this.words = make('output');
    this.element = make('div', {className: 'contrast'}, this.words, make('div', {className: 'histogram-box'}, this.canvas, ...this.handles),
      button('Whole range', () => this.set([least, most])), button('0.5 to 99.5 %', () => this.set([low, high])), button('This view', () => this.ofView()));
    this.set(this.window);
  }

  set(window) {
    if (!(window[0] < window[1])) return this.draw();
    this.window = window;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.pane.layer?.setContrast(...window), SOON);
    this.words.textContent = `Gray ${short(window[0])} black, ${short(window[1])} white`;
    return this.draw();
  }

  // 0.5 to 99.5 % of the pixels in the window of the pane
  async ofView() {
    const {name, owner} = this.pane, {canvas} = owner.frame;
    const bounds = owner.mapping(this.pane, canvas)?.bounds(canvas.clientWidth, canvas.clientHeight);
    if (!bounds) return;
    const asked = new URLSearchParams({name, line0: bounds[0][0], line1: bounds[0][1], sample0: bounds[1][0], sample1: bounds[1][1]});
    const found = await owner.app.orSay(owner.app.request(`/api/image/contrast?${asked}`));
    if (found) this.set([found.low, found.high]);
  }

  draw() {
    this.handles.forEach((handle, k) => { handle.value = this.window[k]; });
    const {context, width, height} = prepared(this.canvas), {counts} = this.picture, most = Math.max(...counts);
    const toX = value => width * (value - this.ends[0]) / (this.ends[1] - this.ends[0]);
    context.clearRect(0, 0, width, height);
    context.fillStyle = 'rgba(86, 180, 233, 0.25)';
    context.fillRect(toX(this.window[0]), 0, toX(this.window[1]) - toX(this.window[0]), height);
    context.fillStyle = pageColors(this.canvas).ink;
    counts.forEach((one, k) => context.fillRect(k * width / counts.length, height, width / counts.length, -height * one / most));
  }
}
