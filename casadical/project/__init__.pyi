from casadical.project.networks import NetworkResult as NetworkResult
from casadical.project.networks import Networks as Networks
from casadical.project.networks import train_networks as train_networks
