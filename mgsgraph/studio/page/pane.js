// One image among those over the same ground: its name, what is under the cross, its canvas, and what the pointer does.

import {Contrast} from './contrast.js';
import {
  drawCross, drawEllipse, drawFrame, drawGrid, drawMeasured, drawNames, drawScale, drawShots, drawTies, tiesSeen, worstFirst,
} from './image_marks.js';
import {label, make, options, prepared, remover, short} from './plot.js';
import {TileLayer} from './tile_layer.js';

const CLOSE = 9; // CSS pixels, from a tie that is chosen
const STILL = 4; // CSS pixels, up to which a press is a click

export class Pane {
  constructor(owner, name) {
    Object.assign(this, {owner, name, image: null, layer: null, pointers: new Map()});
    this.chooser = make('select', {title: 'Image', ariaLabel: 'Image', onchange: () => this.choose(this.chooser.value)},
      ...options(owner.app.scene.images.map(one => [one.name])));
    this.chooser.value = name;
    const away = remover('Remove this image', () => owner.removePane(this));
    this.canvas = make('canvas', {tabIndex: 0, className: 'image-canvas', role: 'application'});
    this.words = make('figcaption');
    this.box = make('div', {className: 'image-box'}, this.canvas);
    this.note = make('p', {className: 'no-picture'});
    this.element = make('figure', {className: 'image-pane'}, make('div', {className: 'image-head'}, this.chooser, this.words, away), this.note, this.box);
    this.listen();
  }

  async choose(name) {
    this.name = name;
    this.close();
    Object.assign(this, {image: null, layer: null});
    if (this.owner.frame === this) Object.assign(this.owner, {link: null, known: null, isWhole: true});
    await this.load();
    this.owner.changedPanes();
  }

  // Read what is known of the image; tiles of the same picture stay
  async load() {
    const {name, owner: {app}} = this;
    this.state = `Reading ${name} …`;
    this.owner.request();
    const image = await app.orSay(app.request(`/api/image?${new URLSearchParams({name})}`));
    if (name !== this.name) return;
    this.state = '';
    if (!image) return;
    const same = this.layer && image.picture?.version === this.image.picture?.version;
    this.image = Object.assign(image, {order: worstFirst(image.ties)});
    this.canvas.ariaLabel = `Image ${name}: arrows move, plus and minus zoom, m measures`;
    if (!same) this.openLayer();
  }

  openLayer() {
    this.layer?.cancel();
    this.layer = this.contrast = null;
    const {picture, sentence} = this.image, owner = this.owner;
    this.note.textContent = picture ? '' : sentence;
    if (!picture) return;
    this.layer = new TileLayer(this.name, this.image, words => owner.app.say(words, 'error'), () => owner.request());
    this.contrast = new Contrast(this, picture);
  }

  close() {
    this.layer?.cancel();
  }

  // --- drawing

  draw(mapping) {
    const {context, width, height, density} = prepared(this.canvas), {owner} = this;
    context.fillStyle = '#2b2b2b';
    context.fillRect(0, 0, width, height);
    this.drawn = mapping;
    if (!width) return;
    if (!this.image || !mapping) return this.say(context, width, height);
    const other = owner.over(this), there = other && owner.mapping(other, this.canvas), blinked = there && owner.blinked;
    if (!blinked) this.pixels(context, mapping, width, height, density);
    if (there) this.beside(context, other, there, width, height, density);
    if (there) other.marks(context, there, width, height, blinked);
    this.marks(context, mapping, width, height, !blinked);
    if (!there || owner.compare !== 'blink') return;
    Object.assign(context, {font: 'bold 15px sans-serif', textAlign: 'left', textBaseline: 'top'});
    label(context, (blinked ? other : this).name, 8, 8);
  }

  pixels(context, mapping, width, height, density) {
    drawFrame(context, mapping, this.image);
    this.layer?.draw(context, mapping, width, height, density);
    if (!this.layer) drawGrid(context, mapping, this.image, width, height);
  }

  // Another image over this one: in its place, to the right of the handle, or this one in red and the other in cyan
  beside(context, other, there, width, height, density) {
    const {compare, blinked, handle} = this.owner;
    const fill = (on, fillStyle, globalCompositeOperation, left = 0, wide = width) => {
      Object.assign(on, {fillStyle, globalCompositeOperation});
      on.fillRect(left, 0, wide, height);
      on.globalCompositeOperation = 'source-over';
    };
    context.save();
    if (compare === 'red') {
      const copy = new OffscreenCanvas(this.canvas.width, this.canvas.height), second = copy.getContext('2d');
      second.scale(density, density);
      fill(second, '#000000', 'source-over');
      other.pixels(second, there, width, height, density);
      fill(context, '#ff0000', 'multiply');
      fill(second, '#00ffff', 'multiply');
      context.globalCompositeOperation = 'lighter';
      context.drawImage(copy, 0, 0, width, height);
    } else if (compare === 'swipe') {
      fill(context, '#ffffff', 'source-over', handle * width - 2, 2);
      context.beginPath();
      context.rect(handle * width, 0, width, height);
      context.clip();
      fill(context, '#2b2b2b', 'source-over');
      other.pixels(context, there, width, height, density);
    } else if (blinked) other.pixels(context, there, width, height, density);
    context.restore();
  }

  say(context, width, height) {
    const words = this.image && this.owner.link ? 'This image does not show the ground under the cross.' : this.state;
    Object.assign(context, {fillStyle: '#dddddd', font: '14px sans-serif', textAlign: 'center'});
    context.fillText(words, width / 2, height / 2, width - 20);
    this.words.textContent = '';
  }

  // Marks and the line about them; in the canvas of another image, only those of the one on top
  marks(context, mapping, width, height, onTop = true) {
    const {owner, image} = this, {shown, cursor, link} = owner, counts = [], at = [width / 2 + cursor[0], height / 2 + cursor[1]];
    const predicted = this === owner.frame ? null : link?.others[this.name];
    if (!onTop) return this.tell(mapping.toImage(...at), predicted, null, counts);
    if (shown.outlines && (shown.turned || this === owner.frame)) owner.outlines(context, this.name, width, height);
    if (shown.shots) {
      const {drawn, all} = drawShots(context, mapping, image.shots, width, height, this === owner.active ? owner.near : null);
      if (drawn < all) counts.push(`${drawn} of ${all} shots`);
    }
    this.seen = shown.ties ? tiesSeen(mapping, image, width, height, owner.app.selection) : [];
    if (this.seen.length < this.seen.all) counts.push(`${this.seen.length} of ${this.seen.all} ties, largest residuals first`);
    const factor = shown.residuals ? Math.max(0, Number(owner.factor.value) || 0) : 0;
    drawTies(context, mapping, image.ties, this.seen, factor, owner.app.selection);
    if (shown.names) drawNames(context, image.ties, this.seen);
    if (shown.ellipses && predicted?.ellipse_px)
      drawEllipse(context, mapping, [predicted.line, predicted.sample], predicted.ellipse_px);
    const place = owner.measuring.placeIn(this.name);
    if (place) drawMeasured(context, mapping, place);
    drawCross(context, ...at, width, height);
    if (this === owner.frame && link) drawScale(context, link.spacing_m[1] / owner.zoom, width, height);
    this.tell(mapping.toImage(...at), predicted, this.tieNear(at), counts);
  }

  // One line: what is under the cross, and how much of what is there is drawn
  tell([line, sample], predicted, tie, counts) {
    const {link} = this.owner, grey = link?.grey?.[this.name];
    const parts = [`line ${line.toFixed(2)}, sample ${sample.toFixed(2)}`];
    if (grey !== null && grey !== undefined) parts.push(`gray ${short(grey)}`);
    if (this === this.owner.frame && link) parts.push(this.owner.position(link));
    if (predicted?.ellipse_px) parts.push(`predicted within ${predicted.ellipse_px.semi_axes_px.map(one => short(one, 2)).join(' × ')} px (95 %)`);
    else if (predicted && !predicted.inside) parts.push('the ground under the cross is outside this image');
    if (tie !== null) parts.push(this.tieWords(tie));
    if (counts.length) parts.push(`drawn: ${counts.join('; ')}`);
    if (this.layer?.late) parts.push('reading pixels …');
    const words = parts.join(' · ');
    if (words !== this.words.textContent) this.words.textContent = this.words.title = words;
  }

  // Whether a place is well inside the canvas
  near(place) {
    if (!this.drawn) return false;
    const [x, y] = this.drawn.toCanvas(...place), {clientWidth: width, clientHeight: height} = this.canvas;
    return x > 0.1 * width && x < 0.9 * width && y > 0.1 * height && y < 0.9 * height;
  }

  tieWords(k) {
    const {ties} = this.image, residual = ties.residuals[k], sigma = ties.sigmas[k];
    const off = residual ? `residual ${short(residual[0], 2)} and ${short(residual[1], 2)} px` : 'no predicted position';
    return `${ties.kinds[k]} ${ties.names[k]}${ties.used[k] ? '' : ', rejected'}: ${off} in line and sample, `
      + `sigma ${short(sigma[0], 2)} and ${short(sigma[1], 2)} px`;
  }

  // The tie nearest to a point of the canvas; null where none is near
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
    for (const kind of ['pointerup', 'pointercancel']) canvas.addEventListener(kind, up);
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      if (owner.fitted()) owner.zoomBy(Math.exp(-Math.max(-300, Math.min(300, event.deltaY)) / 400));
    }, {passive: false});
    canvas.addEventListener('focus', () => owner.activate());
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
