from casadical.blind_check.own_robot import check_robot as check_robot
