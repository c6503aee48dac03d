// One image among those side by side: its name, its contrast, its canvas, and what the pointer does there.

import {
  drawCross, drawEllipse, drawFrame, drawMeasured, drawNames, drawScale, drawShots, drawTies, tiesSeen,
} from './image_marks.js';
import {make, prepared, short} from './plot.js';
import {TileLayer} from './tile_layer.js';

const CLOSE = 9; // CSS pixels, from a tie that is chosen
const STILL = 4; // CSS pixels, up to which a press is a click

export class Pane {
  constructor(owner, name) {
    Object.assign(this, {owner, name, image: null, layer: null, pointers: new Map()});
    this.chooser = make('select', {title: 'Image'});
    this.chooser.setAttribute('aria-label', 'Image');
    for (const one of owner.app.scene.images)
      this.chooser.append(make('option', {value: one.name, textContent: one.name, selected: one.name === name}));
    this.chooser.addEventListener('change', () => this.choose(this.chooser.value));
    const away = make('button', {type: 'button', textContent: '×', title: 'Take this image away'});
    away.addEventListener('click', () => owner.removePane(this));
    this.canvas = make('canvas', {tabIndex: 0, className: 'image-canvas'});
    this.canvas.setAttribute('role', 'application');
    this.words = make('figcaption', {textContent: ''});
    this.contrast = make('div', {className: 'contrast'});
    this.element = make('figure', {className: 'image-pane'},
      make('div', {className: 'image-head'}, this.chooser, away), this.canvas, this.contrast, this.words);
    this.listen();
  }

  async choose(name) {
    this.name = name;
    const first = this.owner.frame === this;
    if (first) Object.assign(this.owner, {link: null, spacing: null});
    await this.load();
    first ? this.owner.whole() : this.owner.ask();
    this.owner.drawProfile();
    this.owner.request();
  }

  // Read what is known of the image; `again` after a change: the picture's tiles stay
  async load(again = false) {
    const name = this.name;
    try {
      const image = await this.owner.app.request(`/api/image?${new URLSearchParams({name})}`);
      if (name !== this.name) return;
      const same = again && this.layer && image.picture?.version === this.image?.picture?.version;
      this.image = image;
      this.canvas.setAttribute('aria-label', `Image ${name}: arrows move, plus and minus zoom, m measures`);
      if (!same) this.openLayer();
    } catch (error) {
      this.owner.app.say(error.message, 'error');
    }
  }

  openLayer() {
    this.layer?.cancel();
    this.layer = null;
    this.contrast.replaceChildren();
    const {picture, sentence} = this.image, owner = this.owner;
    if (!picture) {
      this.contrast.append(make('p', {className: 'no-picture', textContent: sentence}));
      return;
    }
    this.layer = new TileLayer(this.name, this.image, words => owner.app.say(words, 'error'), () => owner.request());
    const input = (key, words) => {
      const {least, most} = picture, fine = Math.max((most - least) / 500, 1e-9);
      const step = Number.isInteger(least) && most - least >= 50 ? Math.ceil(fine) : fine;
      const slider = make('input', {type: 'range', min: least, max: most, step, title: `${words} (grey value)`});
      slider.value = picture[key];
      slider.setAttribute('aria-label', words);
      slider.addEventListener('input', () => this.stretch());
      return slider;
    };
    this.low = input('low', 'Black');
    this.high = input('high', 'White');
    const reset = make('button', {type: 'button', textContent: 'Auto', title: 'Black and white at 0.5 % and 99.5 %'});
    reset.addEventListener('click', () => {
      this.low.value = picture.low;
      this.high.value = picture.high;
      this.stretch();
    });
    this.contrast.append(make('label', {}, 'Black ', this.low), make('label', {}, 'White ', this.high), reset);
  }

  stretch() {
    const low = Number(this.low.value), high = Number(this.high.value);
    clearTimeout(this.timer);
    if (low < high) this.timer = setTimeout(() => this.layer?.setContrast(low, high), 120);
    else this.owner.app.say('Black must be below white.', 'error');
  }

  close() {
    this.layer?.cancel();
  }

  // --- drawing

  draw(mapping) {
    const {context, width, height, density} = prepared(this.canvas);
    context.fillStyle = '#2b2b2b';
    context.fillRect(0, 0, width, height);
    this.drawn = mapping;
    if (!this.image || !width) return;
    if (!mapping) return this.say(context, width, height);
    drawFrame(context, mapping, this.image);
    this.layer?.draw(context, mapping, width, height, density);
    this.marks(context, mapping, width, height);
  }

  say(context, width, height) {
    context.fillStyle = '#dddddd';
    context.font = '14px sans-serif';
    context.textAlign = 'center';
    context.fillText(this.owner.link ? 'This image does not show the ground under the cross.' : 'Looking …', width / 2,
      height / 2, width - 20);
    this.words.textContent = '';
  }

  marks(context, mapping, width, height) {
    const {owner, image} = this, {shown, cursor, link} = owner;
    if (shown.shots) drawShots(context, mapping, image.shots, width, height, this === owner.active ? owner.near : null);
    this.seen = tiesSeen(mapping, image.ties, width, height);
    const factor = shown.residuals ? Math.max(0, Number(owner.factor.value) || 0) : 0;
    if (shown.ties) drawTies(context, mapping, image.ties, this.seen, factor, owner.app.selection);
    if (shown.ties && shown.names) drawNames(context, image.ties, this.seen);
    const predicted = this === owner.frame ? null : link?.others[this.name];
    if (shown.ellipses && predicted?.ellipse_px)
      drawEllipse(context, mapping, [predicted.line, predicted.sample], predicted.ellipse_px);
    const place = owner.measuring.placeIn(this.name);
    if (place) drawMeasured(context, mapping, place);
    const at = [width / 2 + cursor[0], height / 2 + cursor[1]];
    drawCross(context, ...at, width, height);
    if (this === owner.frame && link) drawScale(context, link.spacing_m[1] / owner.zoom, width, height);
    this.tell(mapping.toImage(...at), predicted, shown.ties ? this.tieNear(at) : null);
  }

  tell([line, sample], predicted, tie) {
    let words = `line ${line.toFixed(2)}, sample ${sample.toFixed(2)} (first pixel's centre at 0.5)`;
    if (predicted?.ellipse_px) {
      const [large, small] = predicted.ellipse_px.semi_axes_px;
      words += `; predicted within ${short(large, 2)} × ${short(small, 2)} px (95 %)`;
    } else if (predicted && !predicted.inside) words += '; the ground under the cross lies beside this image';
    if (tie !== null) words += `; ${this.tieWords(tie)}`;
    if (words !== this.words.textContent) this.words.textContent = words;
  }

  // Whether a place is well inside the canvas
  near(place) {
    if (!this.drawn) return false;
    const [x, y] = this.drawn.toCanvas(...place), {clientWidth: width, clientHeight: height} = this.canvas;
    return x > 0.1 * width && x < 0.9 * width && y > 0.1 * height && y < 0.9 * height;
  }

  tieWords(k) {
    const {ties} = this.image, residual = ties.residuals[k], sigma = ties.sigmas[k];
    const off = residual ? `residual ${short(residual[0], 2)} and ${short(residual[1], 2)} px` : 'no place';
    return `${ties.kinds[k]} ${ties.names[k]}${ties.used[k] ? '' : ', rejected'}: ${off} in line and sample, `
      + `sigma ${short(sigma[0], 2)} and ${short(sigma[1], 2)} px`;
  }

  // Name of the tie nearest to a point of the canvas; none where it is far
  tieAt(at) {
    const k = this.tieNear(at);
    return k === null ? null : this.image.ties.names[k];
  }

  tieNear([x, y]) {
    let best = null, least = CLOSE;
    for (const one of this.seen || []) {
      const away = Math.hypot(one.x - x, one.y - y);
      if (away < least) [best, least] = [one.k, away];
    }
    return best;
  }

  // --- pointer

  listen() {
    const {canvas, owner} = this;
    canvas.addEventListener('pointerdown', event => {
      canvas.focus();
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
      this.travelled = 0;
    });
    canvas.addEventListener('pointermove', event => this.moved(event));
    const up = event => {
      const known = this.pointers.delete(event.pointerId);
      if (known && event.type === 'pointerup' && this.travelled < STILL) owner.take(this);
      owner.ask();
    };
    canvas.addEventListener('pointerup', up);
    canvas.addEventListener('pointercancel', up);
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      if (owner.fitted()) owner.zoomBy(Math.exp(-Math.max(-300, Math.min(300, event.deltaY)) / 400));
    }, {passive: false});
    canvas.addEventListener('focus', () => owner.drawProfile());
  }

  moved(event) {
    const {owner, canvas, pointers} = this, before = pointers.get(event.pointerId), at = [event.offsetX, event.offsetY];
    if (!owner.fitted()) return;
    const cross = [at[0] - canvas.clientWidth / 2, at[1] - canvas.clientHeight / 2];
    if (!before) return owner.moveCross(...cross);
    const dx = at[0] - before[0], dy = at[1] - before[1];
    this.travelled += Math.hypot(dx, dy);
    pointers.set(event.pointerId, at);
    if (pointers.size === 2) {
      const [one, other] = [...pointers.values()], now = Math.hypot(one[0] - other[0], one[1] - other[1]);
      const was = event.pointerId === [...pointers.keys()][0]
        ? Math.hypot(before[0] - other[0], before[1] - other[1]) : Math.hypot(one[0] - before[0], one[1] - before[1]);
      owner.cursor = [(one[0] + other[0] - canvas.clientWidth) / 2, (one[1] + other[1] - canvas.clientHeight) / 2];
      if (was > 0) owner.zoomBy(now / was);
      owner.pan(dx / 2, dy / 2);
    } else {
      owner.cursor = cross;
      owner.pan(dx, dy);
    }
  }
}
