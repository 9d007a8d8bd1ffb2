"""The linear-Gaussian model: likelihoods, marginal likelihoods, estimates and predictions.

It knows nothing of robots. Rows come in blocks (the numbers measured at one pose, the samples of
one window), n blocks of m rows; the noise of different blocks is independent. The residual is

    r = J delta + E theta + noise,
    in each block noise ~ N(0, sigma^2 (I + rho^2 Jq Jq')),

with a few base parameters delta ~ N(delta0, diag(prior^2)) and very many columns E, of which groups
are judged as causes. Blocks with fewer rows than m are padded with rows of zeros.

- `noise`: the covariance of the noise and its whitening; AR(1) noise; the gain in log likelihood on a
  grid of sigma and the effect size kappa
- `columns`: the columns E, computed some blocks at a time, and their combinations
- `normal_equations`: normal sums of whitened rows; parameters that are added to a model
- `model`: `LinearModel`, the user's input
- `sums`: Gram matrices of the whitened columns, accumulated over the blocks for every rho
- `marginals`: marginal log likelihoods of groups of columns over the grid
- `search`: the posterior over the next group, and the steps by which groups are added
- `fit`: estimates at one noise level, and residuals of blocks that the fit excludes

The formulas are in docs/linear-gaussian.md.
"""
