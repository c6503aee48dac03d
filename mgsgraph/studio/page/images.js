// Images side by side over the same ground. The first one's pixels are the frame; the others follow by the Jacobian of
// the last answer of the server, at once, and by the next answer exactly.

import {ofFrame, ofOther, upright} from './affine.js';
import {drawLaser, nearestShot} from './laser_plot.js';
import {Measuring} from './measuring.js';
import {Pane} from './pane.js';
import {make, short} from './plot.js';

const MOST = 4; // panes
const SHOWN = [
  ['ties', 'Ties', true], ['names', 'Names', false], ['residuals', 'Residuals', true], ['shots', 'Shots', true], ['ellipses', 'Predicted places', true],
  ['turned', 'Turn to the first image', true], ['shape', 'Shape of the ground', false],
];
const STEP = 60; // CSS pixels by which an arrow key moves

export class Images {
  constructor(app, element) {
    Object.assign(this, {app, element, panes: [], centre: null, zoom: 0, link: null, cursor: [0, 0], shown: {}});
    this.statistics = {draws: 0, milliseconds: 0};
    this.asked = {running: false, next: null};
    element.classList.add('images');
    this.build();
    this.measuring = new Measuring(app, this, this.dialogPlace);
    app.addEventListener('opened', () => this.open());
    app.addEventListener('changed', event => this.changed(event.detail));
    app.addEventListener('renewed', () => this.refresh());
    app.addEventListener('selected', () => this.showPoint(app.selection));
    element.addEventListener('keydown', event => this.key(event));
    new ResizeObserver(() => this.fitted() && this.request()).observe(element);
    if (app.scene) this.open();
  }

  build() {
    const tools = make('div', {className: 'image-tools', role: 'group'});
    tools.setAttribute('aria-label', 'What is drawn on the images');
    for (const [key, words, on] of SHOWN) {
      this.shown[key] = on;
      const box = make('input', {type: 'checkbox', checked: on});
      box.addEventListener('change', () => {
        this.shown[key] = box.checked;
        this.request();
      });
      tools.append(make('label', {}, box, ` ${words}`));
    }
    this.factor = make('input', {type: 'number', min: 1, max: 10000, value: 20, className: 'factor'});
    this.factor.addEventListener('input', () => this.request());
    tools.append(make('label', {}, 'Residuals × ', this.factor));
    const button = (words, act, title) => {
      const one = make('button', {type: 'button', textContent: words, title});
      one.addEventListener('click', act);
      tools.append(one);
      return one;
    };
    this.adder = button('Add an image', () => this.addPane(), 'One more image beside the others');
    button('Whole image', () => this.whole(), 'Show the whole first image (0)');
    button('Pixels 1 : 1', () => this.zoomTo(1), 'One pixel of the first image on one of the screen');
    this.measureButton = button('Measure', () => this.measuring.open(), 'Measure a point in these images (m)');
    this.place = make('p', {className: 'image-ground', textContent: 'Move over an image to see its ground.'});
    this.place.setAttribute('aria-live', 'off');
    this.row = make('div', {className: 'image-panes'});
    this.dialogPlace = make('div');
    this.laser = make('canvas', {className: 'laser-profile', tabIndex: 0});
    this.laser.setAttribute('role', 'img');
    this.laserWords = make('p', {className: 'caption'});
    this.legend = make('p', {className: 'image-legend'});
    for (const [key, words] of [
      ['tie', '+ tie, line: residual'], ['rejected', '× rejected'], ['before', '○ shot before'], ['after', '△ shot after'],
      ['ellipse', '○ place predicted for the ground under the cross, with 95 % probability'],
    ])
      this.legend.append(make('span', {className: `mark-${key}`, textContent: words}));
    this.element.replaceChildren(tools, this.dialogPlace, this.place, this.row, this.legend, this.laser, this.laserWords);
    this.laser.addEventListener('click', event => this.pickShot(event));
  }

  // --- images

  get frame() {
    return this.panes[0];
  }

  async open() {
    const names = this.app.scene.images.map(one => one.name);
    this.panes.forEach(one => one.close());
    this.panes = [];
    this.row.replaceChildren();
    this.link = null;
    this.zoom = 0;
    if (!names.length) return;
    await this.addPane(names[0]);
    if (names.length === 1) return;
    const {lines, samples} = this.frame.image || {};
    let second = names[1];
    try {
      const found = await this.ground(names[0], [lines / 2, samples / 2], []);
      second = Object.keys(found.others)[0] || second;
    } catch (error) {
      this.app.say(error.message, 'error');
    }
    await this.addPane(second);
  }

  async addPane(name) {
    if (this.panes.length >= MOST) return this.app.say(`At most ${MOST} images side by side.`, 'error');
    const names = this.app.scene.images.map(one => one.name), here = this.panes.map(one => one.name);
    const unseen = Object.keys(this.link?.others || {}).filter(one => !here.includes(one));
    const chosen = typeof name === 'string' ? name : unseen[0] || names.find(one => !here.includes(one)) || names[0];
    const pane = new Pane(this, chosen);
    this.panes.push(pane);
    this.row.append(pane.element);
    this.row.dataset.count = this.panes.length;
    this.adder.disabled = this.panes.length >= MOST;
    await pane.load();
    this.changedPanes();
  }

  removePane(pane) {
    if (this.panes.length < 2) return;
    pane.close();
    pane.element.remove();
    const first = this.frame === pane;
    this.panes = this.panes.filter(one => one !== pane);
    this.row.dataset.count = this.panes.length;
    this.adder.disabled = false;
    if (first) this.whole();
    this.changedPanes();
  }

  changedPanes() {
    if (!this.fitted()) this.whole();
    this.ask();
    this.drawProfile();
    this.request();
  }

  // The point's measures as they are now, until all is read anew
  changed({point, measures} = {}) {
    for (const {name, image} of this.panes) {
      if (!measures || !image) continue;
      const {ties} = image, now = measures.find(one => one.image === name), columns = ['names', 'measured', 'residuals', 'sigmas', 'used', 'kinds'];
      let k = ties.names.indexOf(point);
      if (k >= 0 && !now) columns.forEach(key => ties[key].splice(k, 1));
      if (!now) continue;
      if (k < 0) k = ties.names.length;
      [point, [now.line, now.sample], null, now.sigma_px, true, ties.kinds[k] || 'tie'].forEach((value, c) => { ties[columns[c]][k] = value; });
    }
    this.request();
  }

  async refresh() {
    this.link = null;
    await Promise.all(this.panes.map(one => one.load(true)));
    this.ask();
    this.drawProfile();
    this.request();
  }

  // --- the common view

  fitted() {
    return this.zoom > 0 && this.centre;
  }

  whole() {
    const {image, canvas} = this.frame || {};
    if (!image || !canvas.clientWidth) return;
    this.centre = [image.lines / 2, image.samples / 2];
    const shape = this.shapeFactor();
    this.zoom = 0.95 * Math.min(canvas.clientHeight / (image.lines * shape), canvas.clientWidth / image.samples);
    this.link = null;
    this.ask();
    this.request();
  }

  // Lines are drawn as high as they are on the ground, where that is wanted
  shapeFactor() {
    const spacing = this.link?.spacing_m || this.spacing;
    if (spacing) this.spacing = spacing;
    return this.shown.shape && spacing ? spacing[0] / spacing[1] : 1;
  }

  mapping(pane) {
    if (!this.fitted()) return null;
    const {clientWidth: width, clientHeight: height} = pane.canvas;
    const frame = ofFrame(this.centre, this.zoom, this.shapeFactor(), width, height);
    if (pane === this.frame) return frame;
    if (!this.link) return null;
    const same = pane.name === this.frame.name ? {...this.link, jacobian: [[1, 0], [0, 1]]} : null;
    const other = same || this.link.others[pane.name];
    const found = other && ofOther(frame, this.link, other);
    return found && !this.shown.turned ? upright(found) : found;
  }

  // [line, sample] of the first image at the cross
  get crossPlace() {
    const pane = this.frame, {clientWidth: width, clientHeight: height} = pane.canvas;
    return this.mapping(pane).toImage(width / 2 + this.cursor[0], height / 2 + this.cursor[1]);
  }

  pan(dx, dy) {
    this.centre = [this.centre[0] - dy / (this.zoom * this.shapeFactor()), this.centre[1] - dx / this.zoom];
    this.request();
  }

  // Zoom about the cross
  zoomBy(factor) {
    const least = 0.2 * Math.min(...['lines', 'samples'].map(key => 100 / this.frame.image[key]));
    const zoom = Math.max(least, Math.min(64, this.zoom * factor)), change = 1 / this.zoom - 1 / zoom;
    this.centre = [
      this.centre[0] + this.cursor[1] * change / this.shapeFactor(), this.centre[1] + this.cursor[0] * change,
    ];
    this.zoom = zoom;
    this.request();
  }

  zoomTo(pixels) {
    if (this.fitted()) this.zoomBy(pixels / (window.devicePixelRatio || 1) / this.zoom);
  }

  moveCross(x, y) {
    this.cursor = [x, y];
    this.ask();
    this.request();
  }

  // --- the server's answers

  ground(name, place, others) {
    const asked = new URLSearchParams({name, line: place[0], sample: place[1]});
    for (const one of others) asked.append('with', one);
    return this.app.request(`/api/image/ground?${asked}`);
  }

  // Ask for the ground under the cross: one question at a time, the last one asked is answered
  async ask() {
    if (!this.fitted() || !this.frame?.image) return;
    this.asked.next = true;
    if (this.asked.running) return;
    this.asked.running = true;
    while (this.asked.next) {
      this.asked.next = false;
      const {name, image} = this.frame, cross = this.crossPlace;
      const place = [Math.max(0, Math.min(image.lines, cross[0])), Math.max(0, Math.min(image.samples, cross[1]))];
      const beside = place[0] !== cross[0] || place[1] !== cross[1];
      try {
        const found = await this.ground(name, place, this.panes.slice(1).map(one => one.name));
        if (name !== this.frame.name) continue;
        if (!found.sentence) this.link = {...found, line: place[0], sample: place[1]};
        this.place.textContent = found.sentence || (beside ? 'At the edge of the first image: ' : '') + this.groundWords(found);
      } catch (error) {
        this.place.textContent = error.message;
      }
      this.request();
    }
    this.asked.running = false;
  }

  groundWords(found) {
    const sigma = found.height_sigma_m === null ? '' : ` (sigma ${short(found.height_sigma_m, 2)} m)`;
    return `Longitude ${found.longitude_deg.toFixed(6)}° E, latitude ${found.latitude_deg.toFixed(6)}° (planetocentric), `
      + `height ${found.height_m.toFixed(1)} m above the ellipsoid${sigma}, ${found.surface}. `
      + `Sigmas: ${found.sigmas}. A pixel is ${short(found.spacing_m[0])} m × ${short(found.spacing_m[1])} m on the ground.`;
  }

  // --- drawing

  request() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  draw() {
    const begin = performance.now();
    for (const pane of this.panes) pane.draw(this.mapping(pane));
    this.near = this.active && nearestShot(this.active, this.mapping(this.active), this.cursor);
    if (this.near?.k !== this.drawnNear?.k || this.near?.profile !== this.drawnNear?.profile) this.drawProfile();
    this.statistics.draws += 1;
    this.statistics.milliseconds += performance.now() - begin;
  }

  // The pane that has the keyboard, or the first one
  get active() {
    return this.panes.find(one => one.canvas === document.activeElement) || this.panes[0];
  }

  drawProfile() {
    this.drawnNear = this.near;
    const pane = this.active;
    if (pane?.image) this.laserWords.textContent = drawLaser(this.laser, pane.image, this.near);
    this.laser.hidden = !pane?.image?.shots.profiles.length;
    this.laser.setAttribute('aria-label', this.laserWords.textContent);
  }

  pickShot(event) {
    const found = this.laser.nearest?.(event.offsetX);
    const place = found && (found.profile.after[found.k] || found.profile.before[found.k]);
    if (place) this.centreOn(this.active, place);
  }

  // --- going to places

  // Bring a place of a pane's image to the middle
  centreOn(pane, place) {
    const mapping = this.mapping(pane);
    if (!mapping) return;
    const [x, y] = mapping.toCanvas(...place), {clientWidth: width, clientHeight: height} = pane.canvas;
    this.cursor = [0, 0];
    this.pan(width / 2 - x, height / 2 - y);
    this.ask();
  }

  showPoint(name) {
    if (!name) return this.request();
    for (const pane of this.panes) {
      const k = pane.image ? pane.image.ties.names.indexOf(name) : -1;
      if (k < 0 || !this.mapping(pane)) continue;
      if (this.element.offsetParent === null || !pane.near(pane.image.ties.measured[k]))
        this.centreOn(pane, pane.image.ties.measured[k]);
      break;
    }
    this.request();
  }

  // The tie of the active image with the next smaller (or larger) residual in units of its sigma
  nextTie(step) {
    const {ties} = this.active.image;
    const size = k => ties.residuals[k] ? Math.hypot(...ties.residuals[k].map((one, c) => one / ties.sigmas[k][c])) : -1;
    const order = ties.names.map((_, k) => k).sort((a, b) => size(b) - size(a));
    if (!order.length) return this.app.say('No tie is measured in this image.', 'error');
    const now = order.findIndex(k => ties.names[k] === this.app.selection);
    const k = order[(now < 0 ? (step > 0 ? 0 : order.length - 1) : now + step + order.length) % order.length];
    this.centreOn(this.active, ties.measured[k]);
    this.app.select(ties.names[k]);
  }

  // --- keyboard

  key(event) {
    const tag = event.target.tagName;
    if (['INPUT', 'SELECT', 'TEXTAREA'].includes(tag) || event.ctrlKey || event.metaKey || event.altKey) return;
    if (!this.fitted() || !this.act(event)) return;
    event.preventDefault();
    event.stopPropagation();
  }

  act(event) {
    const ways = {ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}, way = ways[event.key];
    if (way) {
      const step = event.shiftKey ? this.zoom : STEP;
      this.cursor = [0, 0];
      this.pan(way[0] * step, way[1] * step);
      this.ask();
    } else if (event.key === '+' || event.key === '=') this.zoomBy(1.25);
    else if (event.key === '-') this.zoomBy(0.8);
    else if (event.key === '0') this.whole();
    else if (event.key === 'm') this.measuring.open();
    else if (event.key === 'n' || event.key === 'p') this.nextTie(event.key === 'n' ? 1 : -1);
    else if (event.key === 'Enter' && event.target.tagName === 'CANVAS') this.take(this.active);
    else if (event.key === 'Escape' && this.measuring.running) this.measuring.close();
    else return false;
    return true;
  }

  // The place at the cross of a pane: measured, or the tie there chosen
  take(pane) {
    const mapping = this.mapping(pane);
    if (!mapping) return;
    const {clientWidth: width, clientHeight: height} = pane.canvas;
    const at = [width / 2 + this.cursor[0], height / 2 + this.cursor[1]];
    if (this.measuring.running) return this.measuring.take(pane, mapping.toImage(...at));
    const [line, sample] = mapping.toImage(...at), name = pane.tieAt(at);
    this.app.place({image: pane.name, line, sample});
    if (name) this.app.select(name);
  }
}

export function panel(app, element) {
  element.view = new Images(app, element);
  return element.view;
}
