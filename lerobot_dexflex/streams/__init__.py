"""An operator's hand as devices send it: readers, one record for all, a receiver, files, retargeting."""
