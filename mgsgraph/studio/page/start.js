// The first screen: what is wrong with the block, the worst of each kind, and what to do next.

import {button, caption, check, form, make, short, table} from './plot.js';

const WORK = [
  ['solve', 'Solve', 'Adjust everything by batch and test the result'], ['match', 'Match', 'Find tie points in all images'],
  ['window', 'Match in the map’s window', 'Find tie points in the part of the ground that the map shows'],
  ['align', 'Align', 'Align laser profiles and images by relief'], ['plan', 'Measure next …', 'Where one more tie point would help most'],
  ['add', 'Add …', 'Add images and control networks'],
];

class Start {
  constructor(app, element) {
    Object.assign(this, {app, element, verdict: make('div'), next: make('div', {className: 'next'})});
    this.files = form('files', 'Files to add', () => this.add(), () => this.files.replaceChildren());
    this.worst = make('div', {}, caption('loading …'));
    element.append(this.verdict, make('h2', {textContent: 'What to do next'}), this.next, this.files, make('h2', {textContent: 'The worst'}), this.worst);
    app.hear(element, ['renewed'], () => this.read());
    for (const name of ['worked', 'shown']) app.addEventListener(name, ({detail}) => this.found && (!detail || detail === 'start') && this.draw());
    app.addEventListener('judged', () => this.verdict.replaceChildren(app.verdict.parts()));
    this.read();
  }

  async read() {
    this.verdict.replaceChildren(this.app.verdict.parts());
    try {
      [this.found, this.listed] = await Promise.all(['/api/worst', '/api/work/files'].map(one => this.app.request(one)));
      this.draw();
    } catch (error) {
      this.worst.replaceChildren(make('p', {textContent: error.message}));
    }
  }

  // Why a kind of work can't be done now; empty where it can
  refusal(kind) {
    const {app, found: {reasons}, listed} = this, own = reasons[kind === 'window' ? 'match' : kind];
    if (kind === 'plan' || own) return own;
    if (app.refusal) return app.refusal;
    if (kind === 'window' && !app.views.map?.view) return 'Open the map and show the ground.';
    if (kind === 'add' && !listed.length) return 'Start the studio with --from FOLDER, a folder of images and control networks.';
    return '';
  }

  draw() {
    const {app, found} = this, refused = new Map();
    const buttons = WORK.map(([kind, words, title]) => {
      const reason = this.refusal(kind);
      if (reason) refused.set(reason, [...(refused.get(reason) || []), words]);
      return button(words, () => this.act(kind), {title: reason || title, disabled: Boolean(reason), className: kind === found.next ? 'first' : ''});
    });
    this.next.replaceChildren(make('div', {className: 'tools'}, ...buttons));
    for (const [reason, kinds] of refused) this.next.append(caption(`${kinds.join(', ')}: ${reason}`));
    const copy = () => app.orSay(navigator.clipboard.writeText(found.command).then(() => app.say('Copied.')));
    if (found.command) this.next.append(make('p', {}, 'To make a project of it: ', make('code', {textContent: found.command}), ' ', button('Copy', copy)));
    this.worst.replaceChildren(worst(app, found));
  }

  act(kind) {
    const {app} = this;
    if (kind === 'add') return this.list();
    if (kind === 'plan') return app.show('questions').then(view => view.plan());
    const [x0, y0, x1, y1] = kind === 'window' ? app.views.map.box() : [];
    return app.work.start(kind === 'window' ? {kind: 'match', x0, y0, x1, y1} : {kind});
  }

  // Files of the folder that the studio was started with
  list() {
    const choose = k => on => { on ? this.chosen.add(k) : this.chosen.delete(k); };
    const boxes = this.listed.map((one, k) => check(`${one.name} (${one.is_image ? 'image' : 'network'})`, false, choose(k)));
    this.chosen = new Set();
    this.files.replaceChildren(...boxes, make('button', {type: 'submit', textContent: 'Add the chosen files'}), button('Close', () => this.files.replaceChildren()));
    boxes[0].control.focus();
  }

  add() {
    const files = [...this.chosen].sort((one, other) => one - other);
    if (files.length) this.files.replaceChildren();
    return files.length ? this.app.work.start({kind: 'add', files}) : this.app.say('Choose one file at least.', 'error');
  }
}

// The worst of each kind: names lead to the sheet or the image, buttons to the other views
export function worst(app, {measurements, points, images, profiles}) {
  const look = (words, view, kind, name, more = {}) => button(words, () => app.look({kind, name, ...more}, view));
  const ways = (...link) => [look('Images', 'images', ...link), ' ', look('Map', 'map', ...link)];
  const why = app.refusal;
  const reject = ({point, image}) => button('Reject', ({target}) => { target.disabled = true; app.tryTo({kind: 'reject', point, image}); },
    {disabled: Boolean(why), title: why || `Reject the measurement of ${point} in ${image}`});
  const measurement = one => [look(one.point, 'point', 'point', one.point), one.image, `${short(one.residual_line_px)}, ${short(one.residual_sample_px)}`,
    short(one.residual_sigmas), [...ways('point', one.point, {image: one.image}), ' ', reject(one)]];
  const profile = one => [look(one.profile, 'map', 'profile', one.profile, {point: one.middle}),
    `${short(one.shift_along_m)}, ${short(one.shift_across_m)}`, short(one.shift_sigmas)];
  return make('div', {className: 'worst'},
    table('Measurements', ['point', 'image', 'residual of line, sample (px)', 'residual / sigma', ''],
      measurements.map(measurement), 'No image measurement has a residual.'),
    table('Points', ['point', '3-D sigma (m)', ''], points.map(one => [look(one.id, 'point', 'point', one.id), short(one.sigma_m), ways('point', one.id)]),
      app.scene.adjusted ? 'No point has a sigma.' : 'Sigmas are known after an adjustment.'),
    table('Images', ['image', 'rms residual (px)'], images.map(one => [look(one.image, 'images', 'image', one.image), short(one.rms_px)]), 'No image has residuals.'),
    table('Laser profiles', ['profile', 'shift along, across (m)', 'shift / sigma'], profiles.map(profile), 'No laser profile has an adjusted shift.'));
}

export {Start as Panel};
