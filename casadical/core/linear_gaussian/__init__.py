"""The linear-Gaussian model: its likelihood, marginals, estimates and predictions. It knows nothing of robots.

Rows come in blocks (the numbers read at one pose, the samples of one window), n blocks of m rows; different blocks have
independent noise. The residual is

    r = J delta + E theta + noise,    in each block noise ~ N(0, sigma^2 (I + sum_k rho_k^2 A_k A_k')),

with a few base parameters delta ~ N(delta0, diag(prior^2)) and very many columns E, of which groups are judged as
causes. Blocks with fewer rows than m have rows of zeros.

- `noise`: the components, their covariance and the one whitening
- `columns`: the columns E, made some blocks at a time, and combinations of them
- `normal_equations`: sums of products of white rows; parameters that join a model
- `grid`: values of sigma, rho and the size kappa; sums and gains of log likelihood over them
- `model`: `LinearModel`, what the user gives
- `sums`: products of columns, added up over the blocks at every rho
- `marginals`: log likelihoods of groups of columns over the grid
- `fit`: estimates at one noise, and predictions of blocks that were left out

The formulas are in docs/linear-gaussian.md.
"""
