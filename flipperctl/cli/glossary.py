"""Words of the field and of our tables, each explained in a sentence or two.

``flipperctl explain`` shows them, and a page of the manual lists them all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

_TEXT = """
action: What a policy chooses at a decision: each flipper pair turns up, stays or turns down, 9
    actions in all. With actions=rates, the turns are continuous.
announced: A failure with a warning within the risk's horizon, three or more decisions before it.
AT-D3QN: The paper's network and learner: a double dueling DQN with separate layers for the terrain
    and the robot. network=at_d3qn
baseline: A controller that policies are compared with on the same episodes, such as level or
    geometric.
best known: The best policy that eval has stored for these episodes, a row of its table where it
    beats all others.
best validation: The validation of a training with the largest mean return, or as train.best_by
    says. Its weights are the run's policy.
Brier score: The mean squared difference between a risk and what came, 1 for a failure and 0 else;
    brier_of_mean in files is that of a constant risk.
bin: A piece of the ground 0.15 m long around the robot. The observation holds the mean height of
    each of 15 bins, and their highest points.
checkpoint: A file with the weights of a policy and its whole configuration. best.safetensors is
    the policy; last.safetensors continues the training.
conditions: A named set of physics, sensing, start and randomisation under which policies are
    trained or evaluated. nominal, the default, randomises nothing.
controller: A policy that is a plugin: a rule, a planner, or one that drives by a trained network,
    such as greedy. The column controller of files names any policy.
decision: One step of the environment: the policy chooses an action, and the robot drives for 0.6
    s (robot.control_period). Other libraries call it a step.
Δ: A difference to a baseline on the same episodes. Below 0 is better for pitch variation and time,
    above 0 for success.
engine: The simulator of the robot's physics: planar (side view, fast) or mujoco (3-D).
episode: One crossing of the ground, from the start to an outcome.
ε: The probability of a random action in a training (epsilon). It falls while the policy learns.
false alarm: An episode that reaches the finish and has a warning. false_warnings in files is the
    share of such episodes' decisions with a warning.
flipper: A driven arm with a track that turns about a hinge. The robot has a front pair and a rear
    pair. An angle above 0 is above the chassis.
generalist: The shipped policy for all kinds of ground and many robots.
H and E: The parts of an observation: H holds the heights of the ground, E the front flipper angle,
    the rear flipper angle and the pitch.
hash: A short code of all settings that shape an episode. Results with equal hashes may be
    compared.
Holm: A correction of p values for several comparisons, which keeps the chance of any false alarm
    at 5 %.
improvement: In compare --json, the probability that a training seed has a better mean score on a
    scene than one of the other method; better is the same of single episodes.
interval: The range in square brackets that contains the true mean in 95 of 100 evaluations:
    Student's t for means, Wilson's for rates.
IQM: Interquartile mean: the mean of the middle half of the mean scores of training seeds on scenes,
    which ignores outliers.
level: The baseline that holds both flipper pairs still at 0 rad. It is strong on stairs.
method: Policies that were trained alike but for their seeds, or one policy.
mpc: Model predictive control: a controller that simulates what follows each action, takes the best
    one, and plans again at the next decision.
not reached: An episode with another outcome than reached; a column of pitch variation is of these.
observation: What a policy sees at a decision: heights of the ground around the robot, flipper
    angles and pitch.
okada: A rule that turns the front flippers along the ground and holds the rear ones level (Okada
    et al. 2011).
outcome: How an episode ends: reached, overturned, stuck or timeout.
overturned: Outcome: the pitch reached 60° (episode.overturn), or the robot rolled over in 3-D.
passable: An episode that at least one of several reference policies can cross (eval --passable).
pitch: The angle of the chassis against level, above 0 with the nose up [rad].
pitch variation: How much the robot rocks: the sum of all absolute pitch changes over an episode
    [rad], θ̂_R in the paper. Less is better; 1.2 rad is typical for a short stair.
pitch variation at decisions: Pitch variation with one sample per decision (0.6 s), as the paper
    seems to count it. It misses what happens between two decisions.
policy: What chooses the actions: a run, a checkpoint, an .onnx file, a shipped policy, a file of
    tune, a folder of drives, hf:USER/NAME or a controller.
price: What an episode that is not reached counts in a score; 2π rad for pitch variation.
profile: The ground in the robot's side view: a line of points (x, z) [m].
reached: Outcome: the robot passed the finish and stands on the ground again.
regret: The return that a policy misses compared with the best of several references on the same
    episodes (inspect reward --regret).
return: The sum of the rewards of an episode. It depends on the rewards; pitch variation and
    success do not. Of a validation, screens and figures show mean_return, over all episodes without
    shaping.
reward: What training maximises: a weighted sum of terms at each decision. flipperctl list rewards
risk: The probability that the episode fails within the next ten decisions, which some policies
    learn (agent.risk). From a threshold on it is a warning.
run: The folder of one training: configuration, metrics, checkpoints.
saturated: The share of decisions at which a reward term is at its lower bound, and therefore
    tells actions apart no more.
score: Of compare: the measure of the episodes that were reached, at most the price, and the price
    of those that were not. Less is better.
scene: A terrain with fixed settings and conditions on which policies are evaluated.
seed: The number from which all random numbers of a training or an evaluation follow. Equal seeds
    give equal results.
still crossed: Between engines, the share of the episodes which the first one reached that the
    second one reaches, too.
stuck: Outcome: the robot made too little progress (episode.stuck_window).
substep: One step of the physics within a decision (sim.substep).
success: The share of episodes with the outcome reached; success_rate in JSON and of --columns.
suite: A named list of scenes that are evaluated together.
sweep: Several trainings from one command: flipperctl train -m seed=1,2,3.
θ̂_R: The paper's symbol for pitch variation, sampled at decisions there and at 100 Hz here.
time: Simulated time from the start to the end of an episode [s]; t_cost in files.
timeout: Outcome: the episode took longer than allowed (episode.slack).
telling episode: The one that most policies finish, of these the one with the largest pitch
    variation; plot and report show it.
validation: Episodes without exploration that are played during a training, to measure the policy
    and to choose the best one.
warning: A decision whose risk is at the policy's threshold or above, or at which the robot hardly
    moves.
"""

GLOSSARY: Mapping[str, str] = {
    word: " ".join(text.split())
    for word, text in re.findall(r"^(\S.*?): (.*(?:\n +.*)*)", _TEXT, flags=re.MULTILINE)
}
"""Word → explanation."""
